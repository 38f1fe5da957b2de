"""Section with the AUC against the naturalness budget, beside the best of equally many random draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shift3d.analysis.html.blocks import Block, Paragraph
from shift3d.analysis.html.figure import DASHES, LEGEND_BELOW, axis, bars, plot, short
from shift3d.analysis.tables.budgets import BudgetCurve, budget_curves, budget_table, budget_text
from shift3d.analysis.variants import Variant
from shift3d.methods import METHODS

_LEAD = (
    "AUC divided by the baseline's AUC, against the budget: the percentile of the reference set that a searched shape "
    "may not exceed. At the 95th percentile, 95 of 100 known vehicles are nearer to the other known vehicles than the "
    "shape is. Bars: 95 %, scenes resampled. Random draws have the same budget and the same number of evaluations; the "
    "gap to the random draws is the gain of the search."
)
_MARKED = ("#d55e00", "#2f8fc9", "#2c9668", "#9467bd", "#b97a00", "#7d7d7d")


def budgets(found: Sequence[Variant]) -> list[Block]:
    """Build the section; empty if no search ran under two budgets."""
    curves, table = budget_curves(found), budget_table(found)
    if table is None:
        return []
    traces = [trace for number, curve in enumerate(curves) for trace in _traces(curve, _MARKED[number % len(_MARKED)])]
    known = [budget_text(budget) for budget in sorted({budget for curve in curves for budget in curve.variants})]
    layout: dict[str, Any] = {
        "xaxis": axis("percentile of the reference set", type="category", categoryarray=known),
        "yaxis": axis("AUC / AUC of the baseline", rangemode="tozero"),
        "legend": LEGEND_BELOW,
    }
    caption = "AUC relative to the baseline, by naturalness budget"
    return [Paragraph(_LEAD), plot("budgets", traces, layout, caption, caption, 380), table]


def _traces(curve: BudgetCurve, colour: str) -> list[dict[str, Any]]:
    """Create one line with error bars per method: solid for solutions, dashed for random draws."""
    traces = []
    for method in ("random_budget", "adversarial"):
        known = {budget: found for budget in curve.variants if (found := curve.ratio(budget, method)) is not None}
        if not known:
            continue
        name = f"{curve.title}: {METHODS[method]}"
        x = [budget_text(budget) for budget in known]
        y = short([found.mean for found in known.values()])
        traces.append(
            {"type": "scatter", "mode": "lines+markers", "x": x, "y": y, "error_y": bars(list(known.values())),
             "line": {"color": colour, "dash": DASHES[method], "width": 3 if method == "adversarial" else 2},
             "name": name, "hovertemplate": f"{name} %{{y:.3f}}<extra></extra>"}
        )  # fmt: skip
    return traces
