"""Placement of point labels in a diagram, without overlaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import textalloc
from matplotlib.axes import Axes

FloatArray = npt.NDArray[np.float64]

_MARKER_PT = 3.6
"""Radius of a marker."""
LABEL, LEADER = "point label", "leader of a label"  # gid of every placed label, and of its leader line.


@dataclass(frozen=True)
class PointLabel:
    """Text for the point (x, y) in data coordinates. strong: bold, and placed first. colour: of the text."""

    text: str
    x: float
    y: float
    strong: bool = False
    colour: str = "#000000"


def place_labels(axes: Axes, labels: Sequence[PointLabel], markers: FloatArray, lines: Sequence[FloatArray]) -> None:
    """Place labels beside their points without overlaps between labels and, if possible, with markers and lines.

    A distant label gets a leader line, which other labels may cross. The figure's layout must be final.

    Args:
        axes: with its limits set.
        markers: (M, 2) in data coordinates.
        lines: (N, 2) each, in data coordinates.
    """
    if not labels:
        return
    ordered = sorted(labels, key=lambda label: not label.strong)
    markers = _with_rims(axes, markers)
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
        max_distance=0.5,
        nbr_candidates=1000,
        linecolor="#404040",
        linewidth=0.5,
        avoid_label_lines_overlap=False,
        avoid_crossing_label_lines=True,
        plot_kwargs={"gid": LEADER},
        gid=LABEL,
        zorder=10,
    )


def _with_rims(axes: Axes, markers: FloatArray) -> FloatArray:
    """Add eight points on the rim of each marker, (M, 2) in data coordinates."""
    angle = np.arange(8) * np.pi / 4
    rim = np.stack((np.cos(angle), np.sin(angle)), axis=1) * _MARKER_PT * axes.figure.dpi / 72
    points = axes.transData.transform(markers)
    around = (points[:, None] + rim).reshape(-1, 2)
    return np.asarray(axes.transData.inverted().transform(np.concatenate((points, around))))
