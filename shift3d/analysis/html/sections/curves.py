"""Section of the threshold-recall curves with bands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Block, Panels, Paragraph, Plot, folded, missing
from shift3d.analysis.html.figure import DASHES, LEGEND_BELOW, axis, band, line, plot
from shift3d.analysis.statistics.intervals import recall_band
from shift3d.analysis.variants import Variant
from shift3d.methods import METHODS
from shift3d.wording import counted

_LEAD = (
    "Share of the inserted vehicles that the detector finds with a score above the threshold, exact at every 0.005. "
    "Bands: 95 %, pointwise, scenes resampled. Point at a curve to read its values; click a name to hide its curve. "
    "The figure of all vehicles counts each task once; the mean in the table of AUCs counts each vehicle once."
)


def thresholds() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the score thresholds of the curves, (201,): every 0.005 from 0 to 1."""
    return np.arange(201) / 200.0


def curves(found: Sequence[Variant]) -> list[Block]:
    """Build the section: one figure per vehicle and one for all; only the first variant is not folded."""
    if not any(len(variant.rows) for variant in found):
        return [missing("No task has a score.")]
    parts = []
    for variant in found:
        panels = [_panel(number, variant, *part) for number, part in enumerate(variant.by_vehicle())]
        parts.append((f"Curves: {variant.label}", [Panels(panels)]))
    return [Paragraph(_LEAD), *folded(parts, shown=1)]


def _panel(number: int, variant: Variant, name: str, rows: pd.DataFrame) -> Plot:
    found = []
    for method, label in METHODS.items():
        own = rows[rows["method"] == method]
        width = 3 if method == "adversarial" else 2
        found.append(RecallCurve(label, own["score"], own["place"], COLOURS[method], DASHES[method], width))
    scenes, tasks = rows["place"].nunique(), rows["task_id"].nunique()
    caption = f"{variant.title}, {name}: {counted(scenes, 'scene')}, {counted(tasks, 'task')}"
    caption += "" if scenes > 1 else "; no band, because there is only one scene"
    label = f"Threshold-recall curves, {variant.label}, {name}"
    return recall_plot(f"curve-{variant.key}-{number}", found, label, caption)


@dataclass(frozen=True)
class RecallCurve:
    """Curve to draw. scores, places: (N,) of its objects. colour, dash, width: of its line."""

    name: str
    scores: pd.Series
    places: pd.Series
    colour: str
    dash: str = "solid"
    width: int = 2


def recall_plot(key: str, curves: Iterable[RecallCurve], label: str, caption: str) -> Plot:
    """Plot threshold-recall curves with bands; legend and label give their areas. Empty curves are left out."""
    traces: list[dict[str, Any]] = []
    areas, at = [], thresholds().astype(np.float32)
    for curve in curves:
        if curve.scores.empty:
            continue
        recall, low, high = recall_band(curve.scores, list(curve.places), thresholds())
        area = f"{curve.scores.mean():.3f}"
        style = {"shape": "hv", "color": curve.colour, "dash": curve.dash, "width": curve.width}
        traces += band(at, low, high, curve.colour, line={"shape": "hv"}, legendgroup=curve.name)
        drawn = line(at, recall, curve.name, style, legendgroup=curve.name)
        traces.append(drawn | {"name": f"{curve.name}, {area}"})
        areas.append(f"{curve.name} {area}")
    layout = {
        "xaxis": axis("score threshold", range=[0, 1]),
        "yaxis": axis("recall", range=[0, 1.02]),
        "legend": LEGEND_BELOW,
        "hovermode": "x unified",
    }
    return plot(key, traces, layout, f"{label}. Areas: {', '.join(areas)}", caption, 340)
