"""Exact overlap of oriented boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.geometry.boxes import CORNER_SIGNS

Float = NDArray[np.float64]


def _overlap_areas(a: Float, b: Float) -> Float:
    """Compute footprint intersection areas (P,) of boxes a (P, 7) and b (P, 7), pair by pair; exactly 0 if apart."""
    # Box b is transformed into the frame of box a, so that boxes far from the origin lose no digits.
    half_a, half_b = a[:, 3:5] / 2.0, b[:, 3:5] / 2.0
    centre = _turned(b[:, :2] - a[:, :2], -a[:, 6])
    turn = b[:, 6] - a[:, 6]
    apart = _apart(centre, turn, half_a, half_b) | _apart(_turned(centre, -turn), turn, half_b, half_a)
    near = np.flatnonzero(~apart)
    corners = _turned(CORNER_SIGNS * half_b[near, None, :], turn[near, None]) + centre[near, None, :]
    areas = np.zeros(len(a))
    areas[near] = _area_within(corners, half_a[near])
    return areas


def _turned(xy: Float, angle_rad: Float) -> Float:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack((cos * xy[..., 0] - sin * xy[..., 1], sin * xy[..., 0] + cos * xy[..., 1]), axis=-1)


def _apart(centre: Float, turn_rad: Float, half: Float, half_other: Float) -> NDArray[np.bool_]:
    """Return the mask of pairs that an axis of the box at the origin separates; centre, turn: of the other box."""
    cos, sin = np.abs(np.cos(turn_rad))[:, None], np.abs(np.sin(turn_rad))[:, None]
    apart = np.abs(centre) >= half + cos * half_other + sin * half_other[:, ::-1]
    return np.asarray(apart.any(axis=1))


def _area_within(corners: Float, half: Float) -> Float:
    """Compute areas (P,) of convex quadrilaterals (P, 4, 2), counter-clockwise, within |x| <= half_x, |y| <= half_y."""
    # Every point is clipped to the nearest point of the rectangle. Outside parts fall on its border and enclose no
    # area: the clipped outline encloses the intersection. Between crossings with the rectangle's lines an edge is
    # straight, so that the polygon formula holds.
    edges = np.roll(corners, -1, axis=1) - corners
    bounds = np.concatenate((half, -half), axis=1)[:, None, :]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossings = (bounds - np.tile(corners, 2)) / np.tile(edges, 2)
    crossings = np.sort(np.clip(np.nan_to_num(crossings), 0.0, 1.0), axis=2)
    moved = np.empty((len(corners), 4, 5, 2))
    moved[:, :, 0] = corners
    moved[:, :, 1:] = corners[:, :, None] + crossings[..., None] * edges[:, :, None]
    limit = half[:, None, None]
    outline = np.clip(moved, -limit, limit).reshape(-1, 20, 2)
    x, y = outline[..., 0], outline[..., 1]
    following = np.roll(outline, -1, axis=1)
    return np.asarray(0.5 * (x * following[..., 1] - y * following[..., 0]).sum(axis=1))


def _pairs_in_reach(a: Float, b: Float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the indices of pairs whose circumscribed circles meet: only these pairs can overlap."""
    reach = (np.hypot(a[:, 3], a[:, 4])[:, None] + np.hypot(b[:, 3], b[:, 4])[None, :]) / 2.0
    distance = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    rows, columns = np.nonzero(distance <= reach)
    return rows, columns


def _as_boxes(boxes: NDArray[np.floating]) -> Float:
    return np.asarray(boxes, dtype=np.float64).reshape(-1, 7)


def iou_bev(a: NDArray[np.floating], b: NDArray[np.floating]) -> Float:
    """Compute the rotated intersection over union of footprints.

    Args:
        a: (N, 7) boxes; b: (M, 7) boxes, same frame.

    Returns: (N, M) float64 in [0, 1]. Boxes without area overlap nothing (0, never NaN).
    """
    a, b = _as_boxes(a), _as_boxes(b)
    rows, columns = _pairs_in_reach(a, b)
    overlap = _overlap_areas(a[rows], b[columns])
    return _over_union(overlap, a[:, 3] * a[:, 4], b[:, 3] * b[:, 4], rows, columns)


def iou_3d(a: NDArray[np.floating], b: NDArray[np.floating]) -> Float:
    """Compute the rotated intersection over union of volumes (both upright): (N, M) float64 in [0, 1]."""
    a, b = _as_boxes(a), _as_boxes(b)
    rows, columns = _pairs_in_reach(a, b)
    top = np.minimum((a[:, 2] + a[:, 5] / 2.0)[rows], (b[:, 2] + b[:, 5] / 2.0)[columns])
    bottom = np.maximum((a[:, 2] - a[:, 5] / 2.0)[rows], (b[:, 2] - b[:, 5] / 2.0)[columns])
    overlap = _overlap_areas(a[rows], b[columns]) * np.clip(top - bottom, 0.0, None)
    return _over_union(overlap, np.prod(a[:, 3:6], axis=1), np.prod(b[:, 3:6], axis=1), rows, columns)


def _over_union(overlap: Float, a: Float, b: Float, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Float:
    """Compute IoUs (N, M), 0 if not listed. overlap: (P,) of the listed pairs. a: (N,), b: (M,) areas or volumes."""
    result = np.zeros((len(a), len(b)))
    union = a[rows] + b[columns] - overlap
    result[rows, columns] = np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0.0)
    return np.clip(result, 0.0, 1.0)
