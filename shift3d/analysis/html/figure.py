"""Plotly figures as parts of the page: drawn by its script, named for who cannot see them."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

from shift3d.analysis.html.document import escape

__all__ = ["COLOURS", "DASHES", "LEGEND_BELOW", "axis", "figure_html", "filled", "plotly_library", "turn_buttons"]

COLOURS = {"baseline": "#7d7d7d", "random": "#2f8fc9", "adversarial_noise": "#b97a00", "adversarial": "#d55e00"}
"""By method; each at least 3:1 against the light and the dark ground, told apart by who does not see all colours."""
DASHES = {"baseline": "solid", "random": "dot", "adversarial_noise": "dash", "adversarial": "solid"}
_GRID = "rgba(128,128,128,0.28)"
_CLEAR = "rgba(0,0,0,0)"
LEGEND_BELOW = {"orientation": "h", "yref": "container", "y": 0.01, "yanchor": "bottom", "itemsizing": "constant"}
_FONT = {"family": "system-ui, sans-serif", "size": 12}


def plotly_library() -> str:
    """Plotly's JavaScript, to be put into the page."""
    from plotly.offline import get_plotlyjs

    library: str = get_plotlyjs()
    return library


def axis(title: str, **settings: Any) -> dict[str, Any]:
    """An axis whose lines show on light and dark."""
    lines = {"gridcolor": _GRID, "zerolinecolor": _GRID, "linecolor": _GRID}
    return {"title": {"text": title}, "automargin": True, **lines, **settings}


def filled(colour: str, opacity: float = 0.18) -> str:
    """A colour #rrggbb as rgba."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def figure_html(
    key: str,
    traces: Sequence[Mapping[str, Any]],
    layout: Mapping[str, Any],
    label: str,
    caption: str,
    height_px: int = 320,
    pair: str = "",
) -> str:
    """A figure of the page.

    Args:
        key: unique in the page; its id is ``plot-<key>``.
        traces, layout: as plotly has them; checked by it.
        label: what the figure shows, for who cannot see it. caption: above it.
        pair: key of the 3D view that turns with this one.

    Raises:
        ValueError: a trace or layout that plotly does not know.
    """
    import plotly.graph_objects as go
    import plotly.io

    common = {
        **{"template": "none", "paper_bgcolor": _CLEAR, "plot_bgcolor": _CLEAR, "font": _FONT},
        "margin": {"l": 8, "r": 8, "t": 34, "b": 8},
        "modebar": {"bgcolor": _CLEAR, "color": "#8a8a8a", "activecolor": "#2f8fc9"},
    }
    figure = go.Figure(data=list(traces), layout={**common, **layout})
    # The engine is named: another one, where it is installed, would write other bytes.
    data = plotly.io.to_json(figure, engine="json").replace("</", "<\\/")
    paired = f' data-pair="plot-{pair}"' if pair else ""
    return (
        f"<figure><figcaption>{escape(caption)}</figcaption>"
        f'<div class="plot" id="plot-{key}" role="img" aria-label="{html.escape(label)}"{paired} '
        f'style="height:{height_px}px"></div>'
        f'<script type="application/json" id="plot-{key}-data">{data}</script></figure>'
    )


_TURNS = (
    ("Turn left", "-0.5236,0,1"),
    ("Turn right", "0.5236,0,1"),
    ("From above", "0,0.35,1"),
    ("From below", "0,-0.35,1"),
    ("Nearer", "0,0,0.8"),
    ("Farther", "0,0,1.25"),
)


def turn_buttons(key: str, name: str) -> str:
    """Buttons that turn a 3D view, and its pair with it, without a mouse. name: of the views, for screen readers."""
    buttons = "".join(f'<button type="button" data-turn="{by}">{text}</button>' for text, by in _TURNS)
    label = html.escape(f"Turn {name}")
    return f'<div class="turn" role="group" aria-label="{label}" data-plot="plot-{key}">{buttons}</div>'
