"""Score along the steps of a search: of one case, and on average."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Block, Paragraph, Plot, folded, missing
from shift3d.analysis.html.figure import LEGEND_BELOW, axis, band, line, marks, plot, short
from shift3d.analysis.results import Sweep, places_of
from shift3d.analysis.statistics.intervals import resampled_band
from shift3d.analysis.variants import Variant
from shift3d.wording import counted

_MISSING = missing("This sweep stored no scores of search steps.")
_VEHICLES = ("#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8a8a")
_LEAD = (
    "Score that the search sees at each step; step 0 is the unchanged vehicle. It is the score of the best box within "
    "5 m before non-maximum suppression, at the precision of the search, so it may differ a little from the scores in "
    "the tables. Mean over tasks; band: 95 %, pointwise, scenes resampled. Steps that break a constraint count too. "
    "The solution is the valid step with the lowest loss, not the last step; step 0 does not count."
)


def paths(sweep: Sweep, found: Sequence[Variant]) -> list[Block]:
    """Build the section: mean path with band of each search. Only searches scored by the attacked detector count."""
    own = [(variant, searched(sweep, variant)) for variant in found if variant.scores_itself]
    parts = [(f"Steps: {variant.label}", [_plot(variant, rows)]) for variant, rows in own if len(rows)]
    return [Paragraph(_LEAD), *folded(parts, shown=2)] if parts else [_MISSING]


def searched(sweep: Sweep, variant: Variant) -> pd.DataFrame:
    """Select a variant's rows of ``trajectories.parquet``, with `place`, see `places_of`."""
    rows = sweep.trajectories[sweep.trajectories["task_id"].isin(set(variant.rows["task_id"]))]
    return rows.assign(place=places_of(rows))


def mean_path(rows: pd.DataFrame) -> tuple[Any, Any, Any, Any]:
    """Compute steps (S,), mean score, and low and high of its band, which are None for a single scene.

    rows: columns task_id, place, step, proposal_score. A search that ended early keeps its last score.
    """
    table = rows.pivot_table(index=["place", "task_id"], columns="step", values="proposal_score").sort_index(axis=1)
    table = table.ffill(axis=1)
    places = list(table.index.get_level_values("place"))
    return table.columns.to_numpy(), *resampled_band(table.to_numpy(), places, "path band")


def _plot(variant: Variant, rows: pd.DataFrame) -> Plot:
    steps, mean, low, high = mean_path(rows)
    colour = COLOURS["adversarial"]
    traces = band(steps, low, high, colour)
    vehicles = [name for name in variant.vehicles if rows["vehicle"].eq(name).any()]
    for number, vehicle in enumerate(vehicles if len(vehicles) > 1 else []):
        at, own, *_ = mean_path(rows[rows["vehicle"] == vehicle])
        style = {"color": _VEHICLES[number % len(_VEHICLES)], "width": 1.5, "dash": "dot"}
        traces.append(line(at, own, vehicle.replace("_", " "), style))
    traces.append(line(steps, mean, "mean", {"color": colour, "width": 3}))
    counts = f"{counted(rows['task_id'].nunique(), 'task')}, {counted(rows['place'].nunique(), 'scene')}"
    last = rows.sort_values("step").groupby("task_id")["valid"].last()
    counts += f"; the last step is valid in {counted(int(last.sum()), 'task')}"
    text = f"{variant.title}: mean score {mean[0]:.3f} → {mean[-1]:.3f} in {steps[-1]} steps; {counts}"
    return plot(f"path-{variant.key}", traces, _layout(int(steps[-1])), f"Score by step. {text}", text, 360)


def case_path(key: str, rows: pd.DataFrame) -> Block:
    """Plot one task's steps and mark the best step, or return a sentence if the sweep stored no steps."""
    rows = rows[rows["proposal_score"].notna()]
    if rows.empty:
        return _MISSING
    steps, scores = rows["step"].to_numpy(), rows["proposal_score"].to_numpy()
    best, broken = rows[rows["kept"]], rows[~rows["valid"]]
    traces = [line(steps, scores, "score", {"color": COLOURS["adversarial"], "width": 2})]
    kinds = ((broken, "breaks a constraint", "x", "#8a8a8a"), (best, "best step", "circle", "#9b5de5"))
    for part, name, symbol, colour in kinds:
        marker = {"size": 10, "symbol": symbol, "color": colour}
        if len(part):
            traces.append(marks(part["step"].to_numpy(), short(part["proposal_score"]), marker, name=name))
    at_best = int(best["step"].iloc[0]) if len(best) else 0
    caption = f"Search score by step: {scores[0]:.2f} at the start; step {at_best} is the best"
    return plot(f"{key}-path", traces, _layout(int(steps[-1])), caption, caption, 260)


def _layout(last: int) -> dict[str, Any]:
    # Plotly chooses up to ten ticks: it divides steps into fractions only below ten of them.
    ticks = {"dtick": 1} if last < 10 else {}
    sides = {"xaxis": axis("step", range=[0, max(last, 1)], **ticks), "yaxis": axis("score", range=[0, 1.02])}
    return {**sides, "legend": {**LEGEND_BELOW, "traceorder": "normal"}, "hovermode": "x unified"}
