"""Table of AUCs in the paper's layout: one row per method, one column per vehicle, and the mean."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from shift3d.analysis.results import natural_by_task
from shift3d.analysis.statistics.intervals import ratio_interval, vehicle_mean_interval
from shift3d.analysis.tables.paper import paper_table_of
from shift3d.analysis.tables.table import Cell, Table, between, number
from shift3d.analysis.variants import Aucs, Variant, aucs_of_scores, differing_settings
from shift3d.detectors.names import FOREIGN, ONNX, OWN
from shift3d.methods import METHODS
from shift3d.naturalness.calibration import NATURAL_RULE
from shift3d.task.exchange import AssetsSpec
from shift3d.wording import counted

_DEFAULT_DETECTOR = "pointpillars"
_FILES_OF: dict[str, str] = {
    OWN: "detector.module=FILE.py",
    ONNX: "detector.file=FILE.onnx attack.search={search}",
    **dict.fromkeys(FOREIGN, "detector.weights=FILE detector.config=FILE"),
}
_VEHICLES = {("set", "wide"): "vehicle=wide"}


def natural_table(scores: pd.DataFrame) -> Table | None:
    """Build the table of AUCs and their ratio to the baseline, over all adversarial shapes and over the natural ones.

    One line per mode, search, attacked detector, alpha and lambda, chosen or not. Means are over the vehicles' AUCs.
    scores: the table of ``final/``. Returns None if naturalness was not measured.
    """
    verdicts = natural_by_task(scores)
    own = scores[(scores["scored_by"] == scores["detector"]) & scores["score"].notna() & (scores["replicate"] == 0)]
    own = own[own["method"].isin(["baseline", "adversarial"]) & own["task_id"].isin(verdicts)]
    rows = own[own.groupby("task_id")["method"].transform("nunique") == 2] if len(own) else own
    if rows.empty:
        return None
    rows = rows.assign(natural=rows["task_id"].map(verdicts))
    lines = []
    rows = rows.assign(settings=differing_settings(rows, ("mode", "search", "accuracy", "effects")))
    keys = ["settings", "detector", "alpha", "lambda"]
    for (settings, detector, alpha, weight), group in rows.groupby(keys, sort=False, dropna=False):
        natural = group[group["natural"]]
        counts = [part["task_id"].nunique() for part in (natural, group)]
        name = f"{detector}, alpha {alpha:g}, lambda {weight:g}"
        line = [f"{settings}, {name}" if settings else name, f"{counts[0]} of {counts[1]}"]
        for part in (group, natural):
            aucs, vehicles = aucs_of_scores(part), list(dict.fromkeys(part["vehicle"]))
            line += [number(aucs.mean(method, vehicles)) for method in ("baseline", "adversarial")]
            line.append(number(aucs.ratio_to_baseline("adversarial", vehicles), 2))
        lines.append(line)
    header = ["", "natural", "baseline", "adversarial", "ratio", "natural: baseline", "adversarial", "ratio"]
    return Table(f"Natural adversarial shapes ({NATURAL_RULE})", header, lines)


def natural_search(scores: pd.DataFrame, assets: Sequence[AssetsSpec] = ()) -> str | None:
    """Return the command to search natural shapes if unbudgeted searches left unnatural ones.

    scores: of ``final/``. assets: of the plan.
    """
    left = {task for task, natural in natural_by_task(scores).items() if not natural}
    rows = scores[scores["task_id"].isin(left) & ~scores["search"].str.contains("_within")]
    if rows.empty:
        return None
    found = input_words(set(rows["dataset"]), set(rows["detector"]), assets, search="random")
    inputs = found.partition(" vehicle=deepsdf")[0]  # whose codes the sweep cannot search
    return f"Hard shapes that stay vehicles: shift3d sweep natural{inputs}"


def input_words(
    datasets: set[str], detectors: set[str], assets: Sequence[AssetsSpec] = (), search: str = "evolution"
) -> str:
    """Return the words after a sweep's name that select the only recorded data set, detector and set of vehicles.

    Streets, the default detector and shipped files need no word. Several data sets, detectors or sets get none.
    assets: of the plan. search: of an ONNX file.
    """
    words = []
    if len(datasets) == 1 and not (dataset := next(iter(datasets))).startswith("street"):
        words.append(f"scenes={dataset} scenes.root=PATH")
    for detector in detectors if len(detectors) == 1 else ():
        own_weights = detector not in (ONNX, *FOREIGN) and any(one.detectors.get(detector) for one in assets)
        words += [f"detector={detector}"] if detector != _DEFAULT_DETECTOR else []
        words += [_FILES_OF[detector].format(search=search)] if detector in _FILES_OF else []
        words += ["detector.weights=FILE"] if own_weights else []
    sets = {(str(one.vehicles["kind"]), one.vehicles["folder"]) for one in assets}
    if len(sets) == 1 and (own := next(iter(sets)))[1] is not None:
        words.append(_VEHICLES.get(own, f"vehicle={own[0]} vehicle.folder=PATH") + " vehicle.name=NAME")
    return "".join(f" {word}" for word in words)


def auc_table(variant: Variant, in_full: bool = False) -> Table:
    """Build the table of AUCs by method and vehicle, with rows for natural shapes and for the chosen lambdas.

    in_full: add 95 % intervals and numbers of scenes as notes, and the paper's rows; takes a second or two.
    """
    vehicles = variant.vehicles
    paper = paper_table_of(variant) if in_full else None
    lines: list[Sequence[Cell]] = []
    kinds: list[str] = []
    for method in METHODS:
        if method in variant.methods:
            lines.append(_line(METHODS[method], variant.aucs, method, vehicles, variant.rows, in_full))
            kinds.append("ours" if method == "adversarial" else "")
        if paper and method in paper.aucs.by_method:
            lines.append(_line(f"{METHODS[method]}, paper", paper.aucs, method, vehicles))
            kinds.append("paper")
    natural = natural_rows(variant)
    for method in ("baseline", "adversarial") if len(natural) else ():
        some = aucs_of_scores(natural)
        label = f"{METHODS[method]}, natural shapes"
        lines.append(_line(label, some, method, vehicles, natural, in_full))
        kinds.append("")
    if chosen := variant.lambdas:
        lines.append(["lambda", *(f"{chosen[name]:g}" if name in chosen else "-" for name in vehicles), "", ""])
        kinds.append("")
    title = f"AUC, {variant.label}"
    if in_full:
        title += "" if "scored_by" in variant.differing else f", scored by {variant.scored_by}"
        if paper:
            title += f"; paper: table {paper.name} of its LaTeX source, {variant.detector}, 500 scenes per vehicle"
    names = [name.replace("_", " ") for name in vehicles] if in_full else _short(vehicles)
    return Table(title, ["method" if in_full else "", *names, "mean", "of baseline"], lines, kinds)


def _line(
    label: str,
    aucs: Aucs,
    method: str,
    vehicles: list[str],
    rows: pd.DataFrame | None = None,
    in_full: bool = False,
) -> Sequence[Cell]:
    """Build a method's line. rows: scores of the method and of the baseline, if known."""
    values = [number(aucs.of(method, vehicle)) for vehicle in vehicles]
    mean = number(aucs.mean(method, vehicles))
    if rows is None or rows.empty:
        return [label, *values, mean, number(aucs.ratio_to_baseline(method, vehicles), 2)]
    own, baseline = with_baseline(rows, method)
    both = pd.concat([own, baseline]) if method != "baseline" else own
    ratio = number(aucs_of_scores(both).ratio_to_baseline(method, vehicles), 2)
    if not in_full:
        return [label, *values, mean, ratio]
    each = [_noted(value, own[own["vehicle"] == vehicle]) for value, vehicle in zip(values, vehicles)]
    ends = ratio_texts(own, baseline)[1]
    return [label, *each, _noted(mean, own), (ratio, ends) if ends else ratio]


def with_baseline(rows: pd.DataFrame, method: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Select a method's rows and the baseline's rows of the same tasks; tasks without the method are in neither."""
    own = rows[rows["method"] == method]
    return own, rows[(rows["method"] == "baseline") & rows["task_id"].isin(own["task_id"])]


def _noted(value: str, rows: pd.DataFrame) -> Cell:
    """Add interval and number of scenes to an AUC. rows: of one vehicle, or of all vehicles for the mean."""
    if rows.empty:
        return value
    ends = between(vehicle_mean_interval(rows), 3) or "no interval"
    return value, ends, counted(rows["place"].nunique(), "scene")


def ratio_texts(rows: pd.DataFrame, baseline: pd.DataFrame) -> tuple[str, str]:
    """Format the ratio of two mean AUCs, and its interval, which is empty if it is a point or infinite."""
    found = ratio_interval(rows, baseline)
    if found is None:
        return "-", ""
    return f"{found.mean:.2f}", between(found, 2) if 0 < found.high - found.low < math.inf else ""


def natural_rows(variant: Variant) -> pd.DataFrame:
    """Select the rows of tasks whose adversarial shape is natural; none if that was not measured."""
    if variant.rows.empty:
        return variant.rows
    return variant.rows[variant.rows["natural"].eq(True)]


def natural_sentence(variant: Variant) -> str | None:
    """Describe the number of natural adversarial shapes by vehicle; None if it was not measured."""
    tasks = variant.rows[variant.rows["natural"].notna()].drop_duplicates("task_id")
    if variant.mode == "pose" or tasks.empty:
        return None
    natural = tasks[tasks["natural"].eq(True)]
    each = [
        f"{name.replace('_', ' ')} {natural['vehicle'].eq(name).sum()} of {count}"
        for name in variant.vehicles
        if (count := tasks["vehicle"].eq(name).sum())
    ]
    of = f"{len(natural)} of {len(tasks)} adversarial shapes ({', '.join(each)})"
    return f"Natural, {NATURAL_RULE}: {of}."


def _short(names: list[str], longest: int = 16) -> list[str]:
    """Truncate names that are too long for a column to prefixes that still differ."""
    if max(map(len, names)) <= longest:
        return names
    length = longest
    while len({name[:length] for name in names}) < len(set(names)):
        length += 1
    return [name if len(name) <= length else f"{name[:length]}~" for name in names]
