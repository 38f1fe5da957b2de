"""The printed tables: AUC by method and vehicle, what did not run, and where the time went."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from shift3d.analysis.tables.accuracy_cost import accuracy_cost, measured_presets
from shift3d.analysis.tables.choices import candidate_tables, reasons
from shift3d.analysis.tables.numerics import diagnostics
from shift3d.vehicles.outline import CAR_RULE
from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["aligned", "auc_tables", "choice_tables", "coverage", "stage_times", "still_cars", "sweep_report"]

_ROWS = (
    ("baseline", "baseline"),
    ("random", "random"),
    ("adversarial_noise", "adversarial + noise"),
    ("adversarial", "adversarial"),
)
_VARIANT = ["alpha", "detector", "scored_by", "accuracy", "effects"]


def sweep_report(tables: Mapping[str, pd.DataFrame], planned: int) -> str:
    """Everything that a sweep prints at its end. tables: those of ``final/`` by name. planned: tasks."""
    times = stage_times(tables["timings"], tables["scores"])
    covered = coverage(tables["scores"], tables["attempts"], planned)
    cost = accuracy_cost(tables["scores"], tables["timings"], *measured_presets())
    cars = still_cars(tables["scores"], tables["shapes"]) if "shapes" in tables else []
    chosen = choice_tables(tables["choices"]) if "choices" in tables else []
    return "\n\n".join(
        [*auc_tables(tables["auc"]), *cars, *chosen, covered, times, cost, diagnostics(tables["scores"])]
    )


def auc_tables(auc: pd.DataFrame) -> list[str]:
    """One table a mode (and a step size, detector and accuracy, where there are several).

    Rows are methods, columns vehicles and their mean, as in the paper's tables of AUC. A vehicle's shape
    results are those of its chosen lambda; data sets are pooled by their number of scores.
    """
    several = [name for name in _VARIANT if auc[name].nunique() > 1]
    tables = []
    for key, group in auc.groupby(["mode", *_VARIANT], sort=False):
        named = dict(zip(["mode", *_VARIANT], key))
        variant = ", ".join(f"{name.replace('_', ' ')} {named[name]}" for name in several)
        title = f"AUC, adversarial {named['mode']}" + (f" ({variant})" if variant else "")
        tables.append(_auc_table(title, group))
    # The paper shows shape before pose.
    return sorted(tables, key=lambda text: "adversarial pose" in text.splitlines()[0])


def _auc_table(title: str, auc: pd.DataFrame) -> str:
    vehicles = list(dict.fromkeys(auc["vehicle"]))
    selected = auc[auc["selected"] & auc["auc"].notna()]
    pooled: dict[tuple[str, str], float] = {}
    for (method, vehicle), group in selected.groupby(["method", "vehicle"], sort=False):
        pooled[method, vehicle] = float((group["auc"] * group["scores"]).sum() / group["scores"].sum())
    lines = []
    baseline = _mean([pooled.get(("baseline", vehicle)) for vehicle in vehicles])
    for method, label in _ROWS:
        values = [pooled.get((method, vehicle)) for vehicle in vehicles]
        if all(value is None for value in values):
            continue
        mean = _mean(values)
        share = f"{mean / baseline:.2f}" if baseline and mean is not None else "-"
        lines.append([label, *(_number(value) for value in [*values, mean]), share])
    lambdas = selected.drop_duplicates("vehicle").set_index("vehicle")["lambda"]
    if lambdas.notna().any():
        chosen = [f"{lambdas[v]:g}" if v in lambdas.index else "-" for v in vehicles]
        lines.append(["lambda", *chosen, "", ""])
    return aligned(title, ["", *_short(vehicles), "mean", "of baseline"], lines)


def still_cars(scores: pd.DataFrame, shapes: pd.DataFrame) -> list[str]:
    """How many adversarial shapes are still cars by a coarse look, and what the AUC is over these alone.

    shapes: the table of ``final/``. Scores are those of the attacked detector; means of the vehicles' means, as an AUC
    over several vehicles is everywhere.
    """
    shapes = shapes[shapes["still_a_car"].notna()]
    rows = scores[(scores["scored_by"] == scores["detector"]) & scores["score"].notna() & (scores["replicate"] == 0)]
    table = rows.pivot_table(index="task_id", columns="method", values="score")
    if shapes.empty or not {"baseline", "adversarial"} <= set(table.columns):
        return []
    whole = shapes.merge(table[["baseline", "adversarial"]], on="task_id", how="inner")
    lines = []
    for (detector, alpha, weight), group in whole.groupby(["detector", "alpha", "lambda"], sort=False, dropna=False):
        cars = group[group["still_a_car"].eq(True)]
        line = [f"{detector}, alpha {alpha:g}, lambda {weight:g}", f"{len(cars)} of {len(group)}"]
        for part in (group, cars):
            means = part.groupby("vehicle")[["baseline", "adversarial"]].mean().mean()
            known = len(part) and means["baseline"] > 0
            line += [f"{value:.3f}" for value in means] if len(part) else ["-", "-"]
            line.append(f"{means['adversarial'] / means['baseline']:.2f}" if known else "-")
        lines.append(line)
    header = ["", "still a car", "baseline", "adversarial", "ratio", "cars: baseline", "adversarial", "ratio"]
    return [aligned(f"Adversarial shapes that are still cars ({CAR_RULE})", header, lines)]


def choice_tables(choices: pd.DataFrame) -> list[str]:
    """The candidates of each hyper-parameter, then why each was chosen; nothing where there was no choice."""
    if choices.empty:
        return []
    tables = [aligned(*table) for table in candidate_tables(choices)]
    return [*tables, "\n".join(reasons(choices))]


def _short(names: list[str], longest: int = 16) -> list[str]:
    """Names that are too long for a column cut to beginnings that still tell them apart."""
    if max(map(len, names)) <= longest:
        return names
    length = longest
    while len({name[:length] for name in names}) < len(set(names)):
        length += 1
    return [name if len(name) <= length else f"{name[:length]}~" for name in names]


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def coverage(scores: pd.DataFrame, attempts: pd.DataFrame, planned: int) -> str:
    """How many tasks have a score, and, of the others, what each came to."""
    scored = scores.loc[scores["score"].notna(), "task_id"].nunique()
    lines = [f"{scored} of {counted(planned, 'task')} scored"]
    without = scores[~scores["task_id"].isin(scores.loc[scores["score"].notna(), "task_id"])]
    for status, count in without.groupby("status", sort=True)["task_id"].nunique().items():
        lines.append(f"  {count} without a score: {status}")
    given_up = attempts[attempts["quarantined"] & ~attempts["task_id"].isin(scores["task_id"])]
    given_up = given_up.drop_duplicates("task_id", keep="last")  # one that was retried has several
    if len(given_up):
        lines.append(f"  {len(given_up)} quarantined (tracebacks in final/attempts.parquet):")
        lines += [f"    {row.task_id}  {row.error}"[:160] for row in given_up.head(5).itertuples()]
        if len(given_up) > 5:
            lines.append(f"    and {len(given_up) - 5} more")
    return "\n".join(lines)


def stage_times(timings: pd.DataFrame, scores: pd.DataFrame) -> str:
    """Mean milliseconds a task by mode and stage, and the share of the task's total."""
    if not len(timings):
        return "no timings"
    modes = scores.drop_duplicates("task_id").set_index("task_id")["mode"]
    timings = timings.assign(mode=timings["task_id"].map(modes))
    tasks = timings.groupby("mode")["task_id"].nunique()
    spent = timings.groupby(["mode", "stage"], sort=False)["milliseconds"].sum()
    lines = []
    for mode, count in tasks.items():
        stages = spent[mode] / count
        total = stages.get("total", stages.sum())
        for stage, milliseconds in stages.sort_values(ascending=False).items():
            lines.append([str(mode), str(stage), f"{milliseconds:.0f}", f"{milliseconds / total:.0%}"])
    return aligned("Time a task", ["mode", "stage", "ms", "share"], lines)


def aligned(title: str, header: list[str], lines: list[list[str]]) -> str:
    """A printed table: columns padded to their widest cell; the first to the left, the others to the right."""
    cells = [header, *lines]
    widths = [max(len(line[i]) for line in cells) for i in range(len(header))]

    def draw(line: list[str]) -> str:
        return "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width) for i, (cell, width) in enumerate(zip(line, widths))
        ).rstrip()

    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    return "\n".join([title, draw(header), rule, *(draw(line) for line in lines)])
