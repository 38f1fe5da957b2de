"""Placement of point labels in a diagram, without overlaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import textalloc
from matplotlib.axes import Axes

FloatArray = npt.NDArray[np.float64]

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

    A distant label gets a leader line. The figure's layout must be final.

    Args:
        axes: with its limits set.
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
