"""Threshold-recall curves with bands."""

from __future__ import annotations

from typing import Any

import numpy as np

from shift3d.analysis.html.document import Section, aside, paragraph
from shift3d.analysis.html.figure import COLOURS, DASHES, LEGEND_BELOW, axis, figure_html, filled
from shift3d.analysis.results import METHODS, Variant
from shift3d.analysis.statistics.areas import Band, recall_band

__all__ = ["curves", "thresholds"]

_OPEN = 2  # variants whose curves are in sight; the others fold


def thresholds() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Where the page's curves have points, (201,): every 0.005 from 0 to 1."""
    return np.arange(201) / 200.0


def curves(found: list[Variant]) -> Section:
    """The section: a figure a vehicle and one of all."""
    body = [
        paragraph(
            "Share of the inserted vehicles that are found with a score above the threshold; exact at every 0.005. "
            "Bands: 95 %, pointwise, scenes redrawn. Point at a curve for its values; click a name to hide it."
        )
    ]
    if not found:
        return Section("curves", "Threshold-recall curves", [paragraph("No task has a score.", "missing")])
    for number, variant in enumerate(found):
        figures = f'<div class="panels">{"".join(_panels(variant))}</div>'
        title = f"{variant.label[0].upper()}{variant.label[1:]}"
        body += [f"<h3>{title}</h3>", figures] if number < _OPEN else [aside(f"Curves: {variant.label}", [figures])]
    return Section("curves", "Threshold-recall curves", body)


def _panels(variant: Variant) -> list[str]:
    names = variant.vehicles
    chosen = [(name.replace("_", " "), variant.rows[variant.rows["vehicle"] == name]) for name in names]
    if len(names) > 1:
        chosen.append(("all vehicles", variant.rows))
    return [_panel(f"curve-{variant.key}-{number}", name, rows) for number, (name, rows) in enumerate(chosen)]


def _panel(key: str, name: str, rows: Any) -> str:
    traces: list[dict[str, Any]] = []
    said = []
    for method, label in METHODS.items():
        own = rows[rows["method"] == method]
        if own.empty:
            continue
        band = recall_band(own["score"], list(own["place"]), thresholds())
        traces += _traces(method, label, band, float(own["score"].mean()))
        said.append(f"{label} {own['score'].mean():.3f}")
    layout = {
        "xaxis": axis("score threshold", range=[0, 1]),
        "yaxis": axis("recall", range=[0, 1.02]),
        "legend": LEGEND_BELOW,
        "hovermode": "x unified",
    }
    scenes, tasks = rows["place"].nunique(), rows["task_id"].nunique()
    caption = f"{name}: {scenes} scene{'s' if scenes != 1 else ''}, {tasks} task{'s' if tasks != 1 else ''}"
    caption += "" if scenes > 1 else "; no band, which takes several scenes"
    label = f"Threshold-recall curves, {name}. Areas: {', '.join(said)}"
    return figure_html(key, traces, layout, label, caption, height_px=340)


def _traces(method: str, label: str, band: Band, auc: float) -> list[dict[str, Any]]:
    colour, at = COLOURS[method], np.round(band.score_threshold, 4).astype(np.float32)
    shape = {"shape": "hv", "color": colour, "dash": DASHES[method], "width": 3 if method == "adversarial" else 2}
    curve = {
        "type": "scatter",
        "mode": "lines",
        "x": at,
        "y": np.round(band.recall, 4).astype(np.float32),
        "line": shape,
        "name": f"{label}, {auc:.3f}",
        "legendgroup": method,
        "hovertemplate": f"{label} %{{y:.3f}}<extra></extra>",
    }
    if band.low is None or band.high is None:
        return [curve]
    edge = {"shape": "hv", "width": 0, "color": colour}
    common = {"type": "scatter", "mode": "lines", "x": at, "line": edge, "hoverinfo": "skip", "showlegend": False}
    sides = [np.round(side, 4).astype(np.float32) for side in (band.low, band.high)]
    return [
        {**common, "y": sides[0], "legendgroup": method},
        {**common, "y": sides[1], "legendgroup": method, "fill": "tonexty", "fillcolor": filled(colour)},
        curve,
    ]
