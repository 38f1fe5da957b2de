"""The paper's experiments as one page of Markdown: what sweeps found, the paper's numbers beside.

``python docs/scripts/experiments.py OUT ... > docs/why/experiments.md``: each OUT is a finished sweep's folder.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from shift3d.analysis.html.sections.bev import pooled_cells
from shift3d.analysis.html.sections.paths import mean_path, searched
from shift3d.analysis.results import METHODS, Sweep, Variant, read_sweep, variants
from shift3d.analysis.statistics.areas import area, mean_area, ratio_interval
from shift3d.analysis.tables.choices import reasons
from shift3d.analysis.tables.paper import paper_table
from shift3d.vehicles.outline import CAR_RULE

if TYPE_CHECKING:
    import pandas as pd

    from shift3d.analysis.statistics.intervals import Interval

__all__ = ["experiments"]

_LEAD = """\
# The paper's experiments, at their small sizes

Written by `python docs/scripts/experiments.py OUT ...` from finished sweeps; `make report OUT=...` draws each with
curves, cells and the vehicles. AUC is the mean score of the best box within 5 m of the inserted vehicle; 95 % intervals
redraw whole scenes. *Italics: the paper, on Waymo's scenes, with its own vehicles and detectors.*
"""
_STEPS = (0, 1, 2, 5, 10, 20, 40)


def experiments(sweeps: Sequence[Sweep]) -> str:
    """The page. Sweeps in the order given; each a section with a table for each detector that scores.

    One that was run before with other settings of the attack has these in its heading.
    """
    sections, before = [], set()
    for sweep in sweeps:
        name = sweep.plan.sweep
        attack = [word for word in sweep.plan.overrides if word.startswith("attack.") and "replicates" not in word]
        told_by = attack if name in before else []
        sections.append("\n".join(_section(sweep, ", ".join(f"`{word}`" for word in (name, *told_by)))))
        before.add(name)
    return "\n".join([_LEAD, *sections])


def _section(sweep: Sweep, heading: str) -> list[str]:
    found = variants(sweep)
    lines = [f"## {heading}", "", _run(sweep)]
    for variant in found:
        lines += ["", f"**{variant.label[0].upper()}{variant.label[1:]}**", "", *_table(variant), *_cars(variant)]
        lines += [*_cells(sweep, variant), *_path(sweep, variant)]
    if not sweep.choices.empty:
        lines += ["", *(f"- {why}" for why in reasons(sweep.choices))]
    return [*lines, ""]


def _run(sweep: Sweep) -> str:
    attempts, tasks = sweep.attempts, len(sweep.plan.tasks)
    minutes = ((attempts["started_unix_s"] + attempts["seconds"]).max() - attempts["started_unix_s"].min()) / 60
    scored = sweep.scored["task_id"].nunique()
    given = ", ".join(f"`{word}`" for word in sweep.plan.overrides if not word.startswith("out="))
    return (
        f"{tasks} tasks ({scored} scored), {sweep.scored['place'].nunique()} scenes, {minutes:.0f} minutes. "
        f"Given: {given or 'nothing'}."
    )


def _table(variant: Variant) -> list[str]:
    paper = paper_table(variant.mode, variant.detector, variant.scored_by)
    names = [name.replace("_", " ") for name in variant.vehicles]
    lines = [_row(["", *names, "mean", "of baseline"]), _row(["---"] * (len(names) + 3))]
    for method in variant.methods:
        lines.append(_row(_ours(variant, method)))
        if paper and method in paper.auc:
            auc = paper.auc[method]
            mean = sum(auc.values()) / len(auc)
            whole = paper.auc.get("baseline", {})
            of = f"*{mean / (sum(whole.values()) / len(whole)):.2f}*" if whole else ""
            each = [f"*{auc[name]:.3f}*" if name in auc else "" for name in variant.vehicles]
            lines.append(_row([f"*{METHODS[method]}, paper*", *each, f"*{mean:.3f}*", of]))
    return lines


def _ours(variant: Variant, method: str) -> list[str]:
    rows = variant.rows[variant.rows["method"] == method]
    baseline = variant.rows[variant.rows["method"] == "baseline"]
    areas = [area(rows[rows["vehicle"] == name]) for name in variant.vehicles]
    whole = mean_area(rows)
    ratio = ratio_interval(rows, baseline) if method != "baseline" else None
    return [
        METHODS[method],
        *("" if each is None else f"{each.interval.mean:.3f}" for each in areas),
        "" if whole is None else _with_interval(whole.interval, 3),
        "" if ratio is None else f"**{_with_interval(ratio, 2)}**",
    ]


def _with_interval(found: Interval, digits: int) -> str:
    return f"{found.mean:.{digits}f} [{found.low:.{digits}f}, {found.high:.{digits}f}]"


def _cars(variant: Variant) -> list[str]:
    if variant.mode != "shape" or not variant.rows["still_a_car"].notna().any():
        return []
    rows: pd.DataFrame = variant.rows[variant.rows["still_a_car"].eq(True)]
    tasks, cars = variant.rows["task_id"].nunique(), rows["task_id"].nunique()
    parts = [mean_area(rows[rows["method"] == method]) for method in ("baseline", "adversarial")]
    if None in parts:
        return ["", f"Still a car: none of {tasks}."]
    before, after = (f"{part.interval.mean:.3f}" for part in parts if part)
    return [
        "",
        f"Still a car ({CAR_RULE}): {cars} of {tasks}; {before} → {after}.",
    ]


def _cells(sweep: Sweep, variant: Variant) -> list[str]:
    cells = pooled_cells(sweep.bev_transfer, variant)
    if cells.empty:
        return []
    fallen, mean = int((cells["mean_reduction"] > 0).sum()), float(cells["mean_reduction"].mean())
    often = cells[cells["scores"] >= 5]
    sure = int((often["mean_reduction"] > 0).sum())
    return [
        "",
        f"In other scenes at other places: {int(cells['scores'].sum())} placements in {len(cells)} cells of 10 m; the "
        f"score falls in {fallen} of them ({fallen / len(cells):.0%}), by {mean:.3f} in the mean of the cells; of the "
        f"{len(often)} cells with five or more, in {sure}.",
    ]


def _path(sweep: Sweep, variant: Variant) -> list[str]:
    rows = searched(sweep, variant) if variant.detector == variant.scored_by else sweep.trajectories.iloc[:0]
    if rows.empty or sweep.plan.sweep != "trajectories":
        return []
    steps, mean, low, high = mean_path(rows)
    at = {int(step): place for place, step in enumerate(steps)}
    shown = [step for step in _STEPS if step in at]
    between = ["" if low is None else f"[{low[at[step]]:.2f}, {high[at[step]]:.2f}]" for step in shown]
    return [
        "",
        _row(["step", *map(str, shown)]),
        _row(["---"] * (len(shown) + 1)),
        _row(["mean score, as the search saw it", *(f"{mean[at[s]]:.3f} {b}" for s, b in zip(shown, between))]),
    ]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    print(experiments([read_sweep(Path(name)) for name in sys.argv[1:]]), end="")
