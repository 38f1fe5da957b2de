"""Labels of points in a diagram, put where they cover neither one another nor what is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import textalloc
from matplotlib.axes import Axes

FloatArray = npt.NDArray[np.float64]

LABEL, LEADER = "point label", "leader of a label"
"""The gid of every label that was placed, and of the line from its point to it."""


@dataclass(frozen=True)
class PointLabel:
    """A text for the point (x, y) in data coordinates. strong: drawn bold, and placed before the others. colour: of
    the text."""

    text: str
    x: float
    y: float
    strong: bool = False
    colour: str = "#000000"


def place_labels(axes: Axes, labels: Sequence[PointLabel], markers: FloatArray, lines: Sequence[FloatArray]) -> None:
    """Write labels beside their points so that they overlap neither one another nor, where that can be had, markers
    and lines; a label that lies farther off has a leader. The figure's layout must be final.

    Args:
        axes: with its limits set.
        labels: what to write.
        markers: (M, 2) in data coordinates.
        lines: (N, 2) each, in data coordinates.
    """
    if not labels:
        return
    ordered = sorted(labels, key=lambda label: not label.strong)
    textalloc.allocate(
        axes,
        [label.x for label in ordered],
        [label.y for label in ordered],
        [label.text for label in ordered],
        x_scatter=markers[:, 0],
        y_scatter=markers[:, 1],
        x_lines=[line[:, 0] for line in lines],
        y_lines=[line[:, 1] for line in lines],
        textsize=7.5,
        fontweight=["bold" if label.strong else "normal" for label in ordered],
        textcolor=[label.colour for label in ordered],
        margin=0.012,
        min_distance=0.02,
        max_distance=0.4,
        nbr_candidates=200,
        linecolor="#404040",
        linewidth=0.5,
        avoid_label_lines_overlap=True,
        avoid_crossing_label_lines=True,
        plot_kwargs={"gid": LEADER},
        gid=LABEL,
        zorder=10,
    )
