"""Exact overlap of oriented boxes; the polygon clipping is shapely's."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from shift3d.geometry.boxes import corners_bev

Float = NDArray[np.float64]


def _overlap_areas(a: Float, b: Float, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Float:
    """Footprint intersection areas (P,) of the pairs (a[rows], b[columns]).

    Coordinates are taken relative to box a before clipping, so that boxes far from the origin lose no digits.
    """
    origin = a[rows][:, None, :2]
    polygons_a = shapely.polygons(corners_bev(a)[rows] - origin)
    polygons_b = shapely.polygons(corners_bev(b)[columns] - origin)
    return np.asarray(shapely.area(shapely.intersection(polygons_a, polygons_b)), dtype=np.float64)


def _pairs_in_reach(a: Float, b: Float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the pairs whose circumscribed circles meet: only these can overlap."""
    reach = (np.hypot(a[:, 3], a[:, 4])[:, None] + np.hypot(b[:, 3], b[:, 4])[None, :]) / 2.0
    distance = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    rows, columns = np.nonzero(distance <= reach)
    return rows, columns


def _as_boxes(boxes: NDArray[np.floating]) -> Float:
    return np.asarray(boxes, dtype=np.float64).reshape(-1, 7)


def iou_bev(a: NDArray[np.floating], b: NDArray[np.floating]) -> Float:
    """Rotated intersection over union of footprints.

    Args:
        a: (N, 7) boxes; b: (M, 7) boxes, same frame.

    Returns:
        (N, M) float64 in [0, 1]. Boxes without area overlap nothing (0, never NaN).
    """
    a, b = _as_boxes(a), _as_boxes(b)
    result = np.zeros((len(a), len(b)))
    rows, columns = _pairs_in_reach(a, b)
    overlap = _overlap_areas(a, b, rows, columns)
    union = (a[:, 3] * a[:, 4])[rows] + (b[:, 3] * b[:, 4])[columns] - overlap
    result[rows, columns] = np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0.0)
    return np.clip(result, 0.0, 1.0)


def iou_3d(a: NDArray[np.floating], b: NDArray[np.floating]) -> Float:
    """Rotated intersection over union of volumes (both upright): (N, M) float64 in [0, 1]."""
    a, b = _as_boxes(a), _as_boxes(b)
    result = np.zeros((len(a), len(b)))
    rows, columns = _pairs_in_reach(a, b)
    top = np.minimum((a[:, 2] + a[:, 5] / 2.0)[rows], (b[:, 2] + b[:, 5] / 2.0)[columns])
    bottom = np.maximum((a[:, 2] - a[:, 5] / 2.0)[rows], (b[:, 2] - b[:, 5] / 2.0)[columns])
    overlap = _overlap_areas(a, b, rows, columns) * np.clip(top - bottom, 0.0, None)
    union = np.prod(a[:, 3:6], axis=1)[rows] + np.prod(b[:, 3:6], axis=1)[columns] - overlap
    result[rows, columns] = np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0.0)
    return np.clip(result, 0.0, 1.0)
