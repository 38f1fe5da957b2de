"""Figures made with plotly, which the page's script draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io
from plotly.offline import get_plotlyjs

from shift3d.analysis.html.blocks import Plot
from shift3d.analysis.statistics.intervals import Interval

DASHES = {
    "baseline": "solid",
    "random": "dot",
    "random_budget": "dot",
    "edited": "dashdot",
    "adversarial_noise": "dash",
    "adversarial": "solid",
}
LEGEND_BELOW = {"orientation": "h", "yref": "container", "y": 0.01, "yanchor": "bottom", "itemsizing": "constant"}
_GRID = "rgba(128,128,128,0.28)"
_CLEAR = "rgba(0,0,0,0)"
_COMMON = {
    **{"template": "none", "paper_bgcolor": _CLEAR, "plot_bgcolor": _CLEAR},
    "font": {"family": "system-ui, sans-serif", "size": 12},
    "margin": {"l": 8, "r": 8, "t": 34, "b": 8},
    "modebar": {"bgcolor": _CLEAR, "color": "#8a8a8a", "activecolor": "#2f8fc9"},
}


def plotly_library() -> str:
    """Return plotly's JavaScript, to be embedded in the page."""
    return str(get_plotlyjs())


def plot(
    key: str,
    traces: Sequence[Mapping[str, Any]],
    layout: Mapping[str, Any],
    label: str,
    caption: str,
    height_px: int = 320,
    pair: str = "",
) -> Plot:
    """Create a figure of the page.

    Args:
        key: unique in the page; the element's id is ``plot-<key>``.
        traces, layout: in plotly's format; plotly checks them.
        label: description for readers who cannot see the figure. caption: shown above it.
        pair: key of the 3D view that rotates with this one.

    Raises: ValueError: a trace or layout that plotly does not know.
    """
    figure = go.Figure(data=list(traces), layout={**_COMMON, **layout})
    # A fixed engine: another installed engine would write other bytes.
    data = plotly.io.to_json(figure, engine="json").replace("</", "<\\/")
    return Plot(key, data, label, caption, height_px, pair)


def axis(title: str, **settings: Any) -> dict[str, Any]:
    """Create an axis whose lines are visible on light and dark backgrounds."""
    lines = {"gridcolor": _GRID, "zerolinecolor": _GRID, "linecolor": _GRID}
    return {"title": {"text": title}, "automargin": True, **lines, **settings}


def filled(colour: str, opacity: float = 0.18) -> str:
    """Convert a colour #rrggbb to rgba."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def short(values: Any) -> Any:
    """Round numbers to four decimals and convert them to float32, to save bytes of the page."""
    return np.round(np.asarray(values, dtype=np.float64), 4).astype(np.float32)


def line(x: Any, y: Any, name: str, style: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    """Create a curve that shows its name and value under the pointer."""
    hover = {"hovertemplate": f"{name} %{{y:.3f}}<extra></extra>"}
    return {"type": "scatter", "mode": "lines", "x": x, "y": short(y), "line": style, "name": name, **hover, **more}


def marks(x: Any, y: Any, marker: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    """Create single points."""
    return {"type": "scatter", "mode": "markers", "x": x, "y": y, "marker": marker, **more}


def bars(found: Sequence[Interval]) -> dict[str, Any]:
    """Create error bars to the ends of intervals; none to an infinite end, as with a single scene."""
    ends = np.array([[one.high - one.mean, one.mean - one.low] for one in found])
    up, down = short(np.where(np.isfinite(ends), ends, 0.0)).T
    return {"type": "data", "symmetric": False, "array": up, "arrayminus": down, "thickness": 1}


def band(x: Any, low: Any, high: Any, colour: str, **more: Any) -> list[dict[str, Any]]:
    """Create the area between two curves; empty if they are None."""
    if low is None or high is None:
        return []
    edge = {"width": 0, "color": colour, **more.pop("line", {})}
    quiet = {"hoverinfo": "skip", "showlegend": False}
    common = {"type": "scatter", "mode": "lines", "x": x, "line": edge, **quiet, **more}
    return [{**common, "y": short(low)}, {**common, "y": short(high), "fill": "tonexty", "fillcolor": filled(colour)}]
