"""The paper's experiments as one page of Markdown: what sweeps found, the paper's numbers beside.

``python docs/scripts/experiments.py OUT ... > docs/why/experiments.md``: each OUT is a finished sweep's folder.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from shift3d.analysis.html.sections.bev import pooled_cells
from shift3d.analysis.html.sections.paths import mean_path, searched
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.tables.auc import auc_table, natural_sentence
from shift3d.analysis.tables.choices import reasons
from shift3d.analysis.tables.table import Cell
from shift3d.analysis.variants import Variant, variants

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
        settings = attack if name in before else []
        sections.append("\n".join(_section(sweep, ", ".join(f"`{word}`" for word in (name, *settings)))))
        before.add(name)
    return "\n".join([_LEAD, *sections])


def _section(sweep: Sweep, heading: str) -> list[str]:
    lines = [f"## {heading}", "", _run(sweep)]
    for variant in variants(sweep.auc, sweep.scored):
        lines += ["", f"**{variant.title}**", "", *_table(variant)]
        if natural := natural_sentence(variant):
            lines += ["", natural]
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
    """The AUC table: the paper's lines in italics, intervals of the means beside them."""
    table = auc_table(variant, in_full=True)
    lines = [_row(table.header), _row(["---"] * len(table.header))]
    for line, kind in zip(table.lines, table.kinds):
        cells = [_cell(cell, with_interval=at >= len(line) - 2) for at, cell in enumerate(line)]
        lines.append(_row([f"*{cell}*" for cell in cells] if kind == "paper" else cells))
    return lines


def _cell(cell: Cell, with_interval: bool) -> str:
    if isinstance(cell, str):
        return cell
    return f"{cell[0]} {cell[1]}" if with_interval and cell[1].startswith("[") else cell[0]


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
