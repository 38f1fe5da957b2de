"""Oriented boxes (x, y, z, dx, dy, dz, heading): geometric centre, metres, heading counter-clockwise from +x."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError

Float = NDArray[np.float64]

CORNER_SIGNS = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
"""Corners (4, 2) of a footprint in units of the half size, counter-clockwise from front left."""


def validate_boxes(boxes: NDArray[np.floating], where: str) -> None:
    """Refuse boxes (N, 7) that are not finite or have no volume. where: source of the boxes, for the error.

    Raises InputError: naming the first offending row and column.
    """
    if boxes.ndim != 2 or boxes.shape[1] != 7:
        raise InputError(f"boxes must be (N, 7), not {boxes.shape}", where, "Give x, y, z, dx, dy, dz, heading.")
    names = ("x", "y", "z", "dx", "dy", "dz", "heading")
    bad = ~np.isfinite(boxes)
    bad[:, 3:6] |= ~(boxes[:, 3:6] > 0.0)
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        what = f"box {row} has {names[column]} = {boxes[row, column]}"
        raise InputError(what, where, "Give positive sizes, and finite numbers alone.")


def corners_bev(boxes: NDArray[np.floating]) -> Float:
    """Compute the footprint corners (N, 4, 2) of boxes (N, 7), counter-clockwise from front left."""
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 7)
    local = CORNER_SIGNS * (boxes[:, None, 3:5] / 2.0)
    cos, sin = np.cos(boxes[:, 6])[:, None], np.sin(boxes[:, 6])[:, None]
    x = cos * local[..., 0] - sin * local[..., 1]
    y = sin * local[..., 0] + cos * local[..., 1]
    return np.stack((x, y), axis=-1) + boxes[:, None, :2]


def corners_3d(boxes: NDArray[np.floating]) -> Float:
    """Compute the corners (N, 8, 3) of boxes (N, 7): the footprint at the bottom, then at the top."""
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 7)
    height = boxes[:, 2:3] + np.repeat((-0.5, 0.5), 4) * boxes[:, 5:6]
    return np.concatenate((np.tile(corners_bev(boxes), (1, 2, 1)), height[..., None]), axis=2)


def points_in_boxes(
    points: NDArray[np.floating], boxes: NDArray[np.floating], margin_m: float = 0.0
) -> NDArray[np.bool_]:
    """Find which points lie inside which boxes.

    Args:
        points: (N, 3) in the frame of the boxes.
        boxes: (M, 7).
        margin_m: distance by which each face is moved outwards.

    Returns: (M, N) bool; points on a face are inside.
    """
    points = np.asarray(points)
    inside = np.zeros((len(boxes), len(points)), dtype=np.bool_)
    x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    for index, box in enumerate(np.asarray(boxes, dtype=np.float64).reshape(-1, 7)):
        half = box[3:6] / 2.0 + margin_m
        reach = 1.000001 * float(np.hypot(half[0], half[1]))  # no rounding puts a point beyond it inside
        near = np.flatnonzero((np.abs(x - box[0]) <= reach) & (np.abs(y - box[1]) <= reach))
        offset = points[near, :3] - box[:3]
        cos, sin = np.cos(box[6]), np.sin(box[6])
        along = cos * offset[:, 0] + sin * offset[:, 1]
        across = cos * offset[:, 1] - sin * offset[:, 0]
        level = np.abs(offset[:, 2]) <= half[2]
        inside[index, near] = level & (np.abs(along) <= half[0]) & (np.abs(across) <= half[1])
    return inside


def count_in_boxes(points: NDArray[np.floating], boxes: NDArray[np.floating]) -> NDArray[np.int32]:
    """Count the points (N, 3) inside each box (M, 7). Returns (M,) int32."""
    counts: NDArray[np.int32] = points_in_boxes(points, boxes).sum(axis=1, dtype=np.int32)
    return counts
