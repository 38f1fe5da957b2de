"""Threshold-recall curves with bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Panels, Paragraph, Plot, Section, folded
from shift3d.analysis.html.figure import DASHES, LEGEND_BELOW, axis, band, line, plot
from shift3d.analysis.statistics.intervals import recall_band
from shift3d.analysis.variants import Variant
from shift3d.methods import METHODS
from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

_TITLE = "Threshold-recall curves"
_LEAD = (
    "Share of the inserted vehicles that are found with a score above the threshold; exact at every 0.005. Bands: "
    "95 %, pointwise, scenes redrawn. Point at a curve for its values; click a name to hide it."
)


def thresholds() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Where the page's curves have points, (201,): every 0.005 from 0 to 1."""
    return np.arange(201) / 200.0


def curves(found: Sequence[Variant]) -> Section:
    """The section: a figure a vehicle and one of all, the first variant in sight."""
    if not any(len(variant.rows) for variant in found):
        return Section("curves", _TITLE, [Paragraph("No task has a score.", "missing")])
    parts = [(f"Curves: {variant.label}", [Panels(_panels(variant))]) for variant in found]
    return Section("curves", _TITLE, [Paragraph(_LEAD), *folded(parts, shown=1)])


def _panels(variant: Variant) -> list[Plot]:
    return [
        _panel(f"curve-{variant.key}-{number}", variant, name, rows)
        for number, (name, rows) in enumerate(variant.by_vehicle())
    ]


def _panel(key: str, variant: Variant, name: str, rows: pd.DataFrame) -> Plot:
    traces: list[dict[str, Any]] = []
    aucs = []
    for method, label in METHODS.items():
        own = rows[rows["method"] == method]
        if own.empty:
            continue
        recall, low, high = recall_band(own["score"], list(own["place"]), thresholds())
        auc, at = f"{own['score'].mean():.3f}", thresholds().astype(np.float32)
        style = {"shape": "hv", "color": COLOURS[method], "dash": DASHES[method],
                 "width": 3 if method == "adversarial" else 2}  # fmt: skip
        stepped = {"line": {"shape": "hv"}, "legendgroup": method}
        traces += band(at, low, high, COLOURS[method], **stepped)
        traces.append(line(at, recall, label, style, legendgroup=method) | {"name": f"{label}, {auc}"})
        aucs.append(f"{label} {auc}")
    layout = {
        "xaxis": axis("score threshold", range=[0, 1]),
        "yaxis": axis("recall", range=[0, 1.02]),
        "legend": LEGEND_BELOW,
        "hovermode": "x unified",
    }
    scenes, tasks = rows["place"].nunique(), rows["task_id"].nunique()
    caption = f"{variant.title}, {name}: {counted(scenes, 'scene')}, {counted(tasks, 'task')}"
    caption += "" if scenes > 1 else "; no band, which takes several scenes"
    label = f"Threshold-recall curves, {variant.label}, {name}. Areas: {', '.join(aucs)}"
    return plot(key, traces, layout, label, caption, height_px=340)
