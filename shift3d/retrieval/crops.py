"""Labelled vehicles cropped from a scene: points, and beams through the box, in the object frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.naturalness.sizes import published_ranges
from shift3d.retrieval.fit import turned
from shift3d.scenes.scene import Scene

Array = NDArray[np.float64]
FEWEST_POINTS = 10
FLOOR_M = 0.2  # lower points of a box are dropped: the ground reaches here on a slope of 3 degrees or in a low box
MARGIN_M = 0.1  # of the box's other faces: labels are a few centimetres off
KEPT_POINTS, KEPT_BEAMS = 128, 48  # largest numbers kept of a crop, spread evenly
_CELL_M = 0.08
_CHORD = (0.15, 0.4, 0.65, 0.9)  # fractions of a beam's path through the box, outside the vehicle
_BEFORE_M = 0.15  # the path ends this far before a return on the vehicle
_SIDE_POINTS = 3


@dataclass(frozen=True)
class Crop:
    """One labelled vehicle of a scene, object frame: x forward, y left, z up, origin at the box's centre.

    label: row among the scene's labels. box: (7,), scene frame. kind: the data set's name for it. points: number of
    scene points in the box above its floor. surface: (P, 3), at most `KEPT_POINTS` of these, which are fitted. free:
    (Q, 3) places that beams passed through. sides: see `visible_sides`. range_m: horizontal, to the box's centre.
    refused: reason against a fit, "" if there is none.
    """

    label: int
    box: Array
    kind: str
    points: int
    surface: Array
    free: Array
    sides: tuple[str, ...]
    range_m: float
    refused: str


def crop_vehicles(scene: Scene) -> list[Crop]:
    """Crop every labelled vehicle of a scene, in label order, with the reason if a crop cannot be fitted.

    Refused: fewer than `FEWEST_POINTS` points ("few_points"), and box sizes that no published vehicle has ("box_size").
    The result depends on the set of points alone, not on their order.
    Source: SHIFT3D, supplement ("cropping out the point cloud corresponding to each vehicle"); limits and free places,
    through which beams passed, are our choice.
    """
    valid = scene.has_beam
    points, origins = scene.points[valid].astype(np.float64), scene.origins[valid].astype(np.float64)
    labels = scene.labels
    named = labels.kinds or labels.names or ("",) * len(labels.boxes)
    rows = np.flatnonzero(labels.mask("vehicle"))
    return [_crop(int(row), labels.boxes[row], named[row], points, origins) for row in rows]


def _crop(label: int, box: Array, kind: str, points: Array, origins: Array) -> Crop:
    half = box[3:6] / 2.0
    near = _meets(points, origins, box[:3], float(np.linalg.norm(half)))
    ends, starts = (turned(values[near] - box[:3], -float(box[6])) for values in (points, origins))
    inside: NDArray[np.bool_] = np.all(np.abs(ends) <= half + MARGIN_M, axis=1)
    own = ends[inside & (ends[:, 2] >= FLOOR_M - half[2])]
    own = own[np.lexsort(own.T)]
    refused = "few_points" if len(own) < FEWEST_POINTS else "" if _vehicle_size(box) else "box_size"
    surface = _spread(own, KEPT_POINTS)
    free = _free_places(starts, ends, inside, half)
    range_m = float(np.hypot(*box[:2]))
    return Crop(label, box, kind, len(own), surface, free, visible_sides(own, half), range_m, refused)


def _meets(points: Array, origins: Array, centre: Array, radius_m: float) -> NDArray[np.bool_]:
    """Return a mask (N,) of beams that enter a sphere before their return."""
    way, offset = points - origins, centre - origins
    length = np.linalg.norm(way, axis=1)
    along = np.einsum("ij,ij->i", way, offset) / length
    apart = np.einsum("ij,ij->i", offset, offset) - along**2
    near: NDArray[np.bool_] = (along > 0.0) & (apart <= (radius_m + MARGIN_M) ** 2) & (length >= along - radius_m)
    return near


def _vehicle_size(box: Array) -> bool:
    ranges = published_ranges()
    names = ("length_m", "width_m", "height_m")
    return all(0.9 * ranges[name][0] <= side <= 1.1 * ranges[name][1] for name, side in zip(names, box[3:6]))


def _spread(points: Array, count: int) -> Array:
    """Reduce sorted points (N, 3) to at most `count`: one per cell, then every n-th."""
    if len(points) > count:
        _, first = np.unique(np.floor(points / _CELL_M).astype(np.int64), axis=0, return_index=True)
        points = points[np.sort(first)]
    return points[_even(len(points), count)]


def _free_places(starts: Array, ends: Array, inside: NDArray[np.bool_], half: Array) -> Array:
    """Return places in the box that beams passed through: up to shortly before a return in it, or all the way."""
    way = ends - starts
    length = np.linalg.norm(way, axis=1)
    aim = way / length[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = (-half - starts) / aim, (half - starts) / aim
    enter = np.maximum(np.nanmax(np.minimum(near, far), axis=1), 0.0)  # a sensor may be in the box
    leave = np.nanmin(np.maximum(near, far), axis=1)
    leave = np.minimum(leave, length - np.where(inside, _BEFORE_M, 0.0))
    kept = np.flatnonzero(leave > enter)
    # Beams that crossed the box say more than beams that ended in it.
    kept = kept[np.lexsort((*ends[kept].T, inside[kept]))]
    through, ended = kept[~inside[kept]], kept[inside[kept]]
    picked = np.concatenate([part[_even(len(part), KEPT_BEAMS // 2)] for part in (through, ended)])
    at = enter[picked, None] + np.array(_CHORD) * (leave - enter)[picked, None]
    return np.asarray((starts[picked, None] + at[..., None] * aim[picked, None]).reshape(-1, 3))


def _even(length: int, count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, max(length - 1, 0), min(count, length)).round().astype(np.int64))


def visible_sides(points: Array, half: Array) -> tuple[str, ...]:
    """Return the sides (front, rear, left, right) that points (N, 3), object frame, lie along. half: (3,) of the box.

    A flank is seen if points near it span over a third of the length, an end if points near it span over half of the
    width. Source: our choice.
    """
    found = []
    for name, axis, sign in (("front", 0, 1.0), ("rear", 0, -1.0), ("left", 1, 1.0), ("right", 1, -1.0)):
        depth = 0.15 * 2 * half[0] if axis == 0 else 0.15 * 2 * half[1]
        near = points[sign * points[:, axis] >= half[axis] - depth]
        reach = (1 / 2 if axis == 0 else 1 / 3) * 2 * half[1 - axis]
        if len(near) >= _SIDE_POINTS and np.ptp(near[:, 1 - axis]) >= reach:
            found.append(name)
    return tuple(found)
