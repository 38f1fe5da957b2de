"""Labels of points in a diagram, put where they cover neither one another nor what is drawn."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = npt.NDArray[np.float64]

LABEL = "point label"
"""The gid of every label that was placed."""

# Distances from the point and directions that are tried, the nearest and the plainest first; pixels at 100 dpi.
_RADII_PX = (7.0, 12.0, 18.0, 26.0, 36.0, 50.0, 68.0, 90.0, 120.0, 150.0)
_ANGLES_RAD = np.deg2rad([0, 180, 90, 270, 45, 135, 225, 315, 20, 160, 200, 340, 70, 110, 250, 290])
# What it costs to cover a label or leave the axes, a marker by the leader, a marker by the label, a piece of another
# label's leader, and 4 px of a line; and what a pixel away from the point costs.
_HARD, _THROUGH, _MARKER, _LEADER, _LINE, _AWAY = 1e4, 1e3, 60.0, 60.0, 3.0, 0.5
# How far from a marker's centre a leader passes it, but for markers this near its own point; pixels at 100 dpi.
_CLEAR_PX = 7.0
_PASSES = 3
_GAP_PX = 3.0


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
    """Annotate points so that labels overlap neither one another nor, where that can be had, markers and lines, and
    that no leader runs through the marker of another point.

    Each label takes the cheapest of some positions around its point, given all the others; some passes over all
    labels let the first ones give way to the last. The figure's layout must be final.

    Args:
        axes: with its limits set.
        labels: what to write.
        markers: (M, 2) in data coordinates.
        lines: (N, 2) each, in data coordinates.
    """
    ordered = sorted(labels, key=lambda label: not label.strong)
    scale = axes.figure.dpi / 100.0
    notes = [_note(axes, label) for label in ordered]
    extents = [note.get_window_extent() for note in notes]
    sizes = [(box.width + 2 * _GAP_PX * scale, box.height + 2 * _GAP_PX * scale) for box in extents]
    points = axes.transData.transform([(label.x, label.y) for label in ordered]) if ordered else np.empty((0, 2))
    marked = axes.transData.transform(markers)
    drawn = [_samples(axes.transData.transform(line), 4.0 * scale) for line in lines]
    along = np.concatenate([*drawn, np.empty((0, 2))])
    inside = np.asarray(axes.get_window_extent().extents)
    boxes: list[FloatArray | None] = [None] * len(ordered)
    for _ in range(_PASSES):
        for number, (point, size) in enumerate(zip(points, sizes)):
            placed = [i for i, box in enumerate(boxes) if box is not None and i != number]
            others = np.array([boxes[i] for i in placed]).reshape(-1, 4)
            leaders = _leaders(others, points[placed].reshape(-1, 2)).reshape(-1, 2)
            tried = _candidates(point, size, scale)
            cost = _cost(tried, point, others, marked, along, inside, scale)
            cost += _LEADER * _within(leaders, tried).sum(axis=0)
            boxes[number] = tried[int(np.argmin(cost))]
    for note, point, box in zip(notes, points, boxes):
        assert box is not None
        offset = ((box[:2] + box[2:]) / 2 - point) * 72.0 / axes.figure.dpi
        note.set_position((float(offset[0]), float(offset[1])))


def _note(axes: Axes, label: PointLabel) -> Any:
    note = axes.annotate(
        label.text,
        (label.x, label.y),
        (0, 0),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=7.5,
        color=label.colour,
        fontweight="bold" if label.strong else "normal",
        arrowprops={"arrowstyle": "-", "color": "#404040", "lw": 0.5, "shrinkA": 0, "shrinkB": 3},
        gid=LABEL,
        zorder=10,
    )
    note.set_in_layout(False)
    return note


def _candidates(point: FloatArray, size: tuple[float, float], scale: float) -> FloatArray:
    """Boxes (C, 4) as x0, y0, x1, y1 whose nearest side is a radius away from the point, nearest first."""
    directions = np.stack((np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)), axis=1)
    half = np.asarray(size) / 2
    # How far the box's edge is from its centre in a direction.
    reach = (half / np.maximum(np.abs(directions), 1e-9)).min(axis=1)
    away = (np.array(_RADII_PX)[:, None] * scale + reach).reshape(-1, 1)
    centres = point + away * np.tile(directions, (len(_RADII_PX), 1))
    return np.concatenate((centres - half, centres + half), axis=1)


def _cost(
    tried: FloatArray,
    point: FloatArray,
    others: FloatArray,
    markers: FloatArray,
    along: FloatArray,
    inside: FloatArray,
    scale: float,
) -> FloatArray:
    """What each candidate (C, 4) covers, and how far it is from its point; (C,)."""
    outside = (tried[:, :2] < inside[:2]).any(axis=1) | (tried[:, 2:] > inside[2:]).any(axis=1)
    overlap = (tried[:, None, :2] < others[None, :, 2:]) & (tried[:, None, 2:] > others[None, :, :2])
    centres = (tried[:, :2] + tried[:, 2:]) / 2
    leader = _leaders(tried, np.broadcast_to(point, (len(tried), 2)))
    crossed = _within(leader.reshape(-1, 2), others).any(axis=1).reshape(leader.shape[:2]).sum(axis=1)
    grown = tried + np.array([-3.0, -3.0, 3.0, 3.0]) * scale
    cost = _HARD * (outside + overlap.all(axis=2).sum(axis=1)) + _LEADER * crossed
    cost = cost + _MARKER * _within(markers, grown).sum(axis=0) + _LINE * _within(along, tried).sum(axis=0)
    cost = cost + _THROUGH * _passed(point, centres, markers, scale)
    return np.asarray(cost + _AWAY * np.hypot(*(centres - point).T) / scale, dtype=np.float64)


def _leaders(boxes: FloatArray, points: FloatArray) -> FloatArray:
    """Points (B, S, 2) on the lines from points (B, 2) to their labels (B, 4), but for the part within the label."""
    towards = (boxes[:, :2] + boxes[:, 2:]) / 2 - points
    return np.asarray(points[:, None, :] + towards[:, None, :] * np.linspace(0.0, 0.8, 17)[None, :, None])


def _passed(point: FloatArray, ends: FloatArray, markers: FloatArray, scale: float) -> FloatArray:
    """(C,) how many of M markers, but those around the point, lie on the straight line to each of some ends (C, 2)."""
    others = markers[np.hypot(*(markers - point).T) > _CLEAR_PX * scale] - point
    line = ends - point
    along = np.clip(others @ line.T / np.maximum((line**2).sum(axis=1), 1e-9), 0.0, 1.0)
    off = others[:, None, :] - along[:, :, None] * line[None, :, :]
    return np.asarray((np.hypot(off[..., 0], off[..., 1]) < _CLEAR_PX * scale).sum(axis=0), dtype=np.float64)


def _within(points: FloatArray, boxes: FloatArray) -> npt.NDArray[np.bool_]:
    """(P, B): which points lie in which boxes."""
    inside = (points[:, None] > boxes[None, :, :2]) & (points[:, None] < boxes[None, :, 2:])
    return np.asarray(inside.all(axis=2))


def _samples(line: FloatArray, spacing: float) -> FloatArray:
    """Points (S, 2) every ``spacing`` along a polyline (N, 2)."""
    pieces = [line[:1]]
    for start, end in itertools.pairwise(line):
        count = max(1, int(np.hypot(*(end - start)) // spacing))
        pieces.append(start + (end - start) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(pieces)
