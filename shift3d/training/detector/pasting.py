"""Ground-truth sampling: vehicles of other scenes, with their measured points, are pasted into a scene.

Source: SECOND (Yan et al. 2018), section 3.4. Our choice beyond it: a vehicle is placed anywhere at its range or
beyond, rotated about the sensor so that the same side is seen, on the local ground. Points are thinned by the square of
the distance; points behind the vehicle and hidden points on it are removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shift3d.geometry.boxes import points_in_boxes
from shift3d.processes import each
from shift3d.training.detector.recipe import Augmentation
from shift3d.training.detector_scenes import MARGIN_M, TrainingScene, load_cached

Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
CLEARANCE_M = 0.25  # above the ground: higher points block a place
GROUND_RADIUS_M, GROUND_POINTS = 3.0, 4
TRIES = 3
BIN_RAD = np.deg2rad(0.8)
HIDDEN_M = 2.0  # a point nearer by more than this hides another


@dataclass(frozen=True)
class VehicleDatabase:
    """Vehicles with their points, in order of ascending range.

    boxes: (V, 7) float32, network frame. range_m: (V,) horizontal. points: V arrays (n, 3), network frame.
    """

    boxes: Floats
    range_m: npt.NDArray[np.float64]
    points: tuple[Floats, ...]

    @classmethod
    def of(cls, files: Sequence[Path], min_points: int, workers: int = 1) -> VehicleDatabase:
        """Collect every vehicle with enough points from cached scenes. In memory: some 40 MB for 600 scenes."""
        boxes: list[Floats] = []
        points: list[Floats] = []
        for own, theirs in each(partial(_vehicles_of, min_points=min_points), files, workers):
            boxes += own
            points += theirs
        stacked = np.asarray(boxes, dtype=np.float32).reshape(-1, 7)
        range_m = np.hypot(stacked[:, 0], stacked[:, 1]).astype(np.float64)
        order = np.argsort(range_m, kind="stable")
        return cls(stacked[order], range_m[order], tuple(points[row] for row in order))


def _vehicles_of(file: Path, min_points: int) -> tuple[list[Floats], list[Floats]]:
    """Return boxes and points of a cached scene's vehicles with enough points."""
    scene = load_cached(file)
    inside = points_in_boxes(scene.points, scene.boxes, MARGIN_M)
    kept = np.flatnonzero(inside.sum(axis=1) >= min_points)
    return [scene.boxes[row] for row in kept], [scene.points[inside[row]] for row in kept]


def pasted(
    scene: TrainingScene,
    database: VehicleDatabase,
    centre: npt.NDArray[np.float64],
    reach_m: float,
    augmentation: Augmentation,
    min_points: int,
    rng: np.random.Generator,
) -> TrainingScene:
    """Paste up to `augmentation.pasted` vehicles within reach_m (in x and y) of a centre (x, y) into the scene."""
    for _ in range(int(rng.integers(augmentation.pasted + 1))):
        for _ in range(TRIES):
            place = centre + rng.uniform(-reach_m, reach_m, 2)
            vehicle = _vehicle_at(scene, database, place, augmentation, rng)
            if vehicle is None:
                continue
            points, box = vehicle
            origin = np.array((0.0, 0.0, scene.sensor_height_m))
            points = points[~_hidden(points, scene.points, origin)]
            if len(points) >= min_points:
                stays = ~behind_box(scene.points, origin, box)
                scene = replace(
                    scene,
                    points=np.concatenate((scene.points[stays], points)),
                    boxes=np.concatenate((scene.boxes, box[None])),
                )
                break
    return scene


def _vehicle_at(
    scene: TrainingScene,
    database: VehicleDatabase,
    place: npt.NDArray[np.float64],
    augmentation: Augmentation,
    rng: np.random.Generator,
) -> tuple[Floats, Floats] | None:
    """Place a random vehicle on the ground. Returns its points and box; None if it is not clear of everything."""
    range_m, (closest, farthest) = float(np.hypot(*place)), augmentation.pasted_range
    first, last = np.searchsorted(database.range_m, (range_m / farthest, range_m / closest))
    if first == last:
        return None
    row = int(rng.integers(first, last))
    box, points = database.boxes[row].copy(), database.points[row]
    apart = np.hypot(scene.boxes[:, 0] - place[0], scene.boxes[:, 1] - place[1])
    if (apart < (np.hypot(scene.boxes[:, 3], scene.boxes[:, 4]) + np.hypot(box[3], box[4])) / 2).any():
        return None
    x, y = place.astype(np.float32)
    close = np.abs(scene.points[:, 0] - x) < GROUND_RADIUS_M
    close &= np.abs(scene.points[:, 1] - y) < GROUND_RADIUS_M
    around = scene.points[close]
    if len(around) < GROUND_POINTS:
        return None  # the sensor does not see the ground there
    ground = float(np.percentile(around[:, 2], 10))
    points = points[rng.random(len(points)) < (database.range_m[row] / range_m) ** 2]
    turn = float(np.arctan2(place[1], place[0]) - np.arctan2(box[1], box[0]))
    cos, sin = np.cos(turn), np.sin(turn)
    offset = points - box[:3]
    offset[:, :2] = offset[:, :2] @ np.array(((cos, sin), (-sin, cos)), dtype=np.float32)
    box[:3], box[6] = (*place, ground + box[5] / 2), np.mod(box[6] + turn + np.pi, 2 * np.pi) - np.pi
    space = box.copy()
    space[2] += CLEARANCE_M
    long = float(np.hypot(box[3], box[4])) / 2 + MARGIN_M > GROUND_RADIUS_M
    if points_in_boxes(scene.points if long else around, space[None], MARGIN_M).any():
        return None
    return np.asarray(offset + box[:3], dtype=np.float32), box


def behind_box(points: Floats, origin: npt.NDArray[np.float64], box: Floats) -> Flags:
    """Return a mask (N,) of points in a box or behind it as seen from `origin`. Exact: a slab test of each beam."""
    to_box = float(np.arctan2(box[1] - origin[1], box[0] - origin[0]))
    distance, radius = float(np.hypot(*(box[:2] - origin[:2]))), float(np.hypot(box[3], box[4])) / 2 + MARGIN_M
    cos, sin = np.float32(np.cos(to_box)), np.float32(np.sin(to_box))
    x, y = points[:, 0] - np.float32(origin[0]), points[:, 1] - np.float32(origin[1])
    ahead, across = cos * x + sin * y, np.abs(cos * y - sin * x)
    # Only returns beyond the near side of the circle around the footprint, on beams that meet it, need the test.
    wide = np.float32(radius / max(1e-3, (max(0.0, distance**2 - radius**2)) ** 0.5))
    rows = np.flatnonzero((ahead > np.float32(distance - radius)) & (across <= wide * ahead + np.float32(1e-3)))
    offset = points[rows] - origin
    cos, sin = np.cos(box[6]), np.sin(box[6])
    into = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
    start, beam = (origin - box[:3]) @ into, offset.astype(np.float64) @ into
    half = box[3:6].astype(np.float64) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-half - start) / beam, (half - start) / beam
    enter = np.fmin(one, two).max(axis=1)  # fractions of the range to the point
    leave = np.fmax(one, two).min(axis=1)
    result = np.zeros(len(points), dtype=bool)
    result[rows[(enter <= leave) & (enter <= 1.0) & (leave >= 0.0)]] = True
    return result


def _hidden(points: Floats, scene: Floats, origin: npt.NDArray[np.float64]) -> Flags:
    """Return a mask (n,) of points hidden by a scene point in the same direction, nearer to the sensor by HIDDEN_M."""
    if not len(points):
        return np.zeros(0, dtype=bool)
    offset = points - origin
    middle = np.arctan2(offset[:, 1].mean(), offset[:, 0].mean())
    cos, sin = np.float32(np.cos(middle)), np.float32(np.sin(middle))
    turned = np.arctan2(cos * offset[:, 1] - sin * offset[:, 0], cos * offset[:, 0] + sin * offset[:, 1])
    ahead, across = cos * scene[:, 0] + sin * scene[:, 1], cos * scene[:, 1] - sin * scene[:, 0]
    widest = np.float32(np.tan(min(float(np.abs(turned).max()) + 2 * BIN_RAD, 1.5)))
    others = scene[(ahead > 0.0) & (np.abs(across) <= widest * ahead)] - origin
    ours, theirs = _directions(offset, middle), _directions(others, middle)
    own, range_m = np.linalg.norm(offset, axis=1), np.linalg.norm(others, axis=1)
    cells, place = np.unique(np.concatenate((ours, theirs)), return_inverse=True)
    nearest = np.full(len(cells), np.inf)
    np.minimum.at(nearest, place[len(ours) :], range_m)
    return np.asarray(nearest[place[: len(ours)]] < own - HIDDEN_M)


def _directions(offset: npt.NDArray[np.floating], middle: float) -> npt.NDArray[np.int64]:
    """Return cells (n,) of azimuth, relative to `middle`, and elevation, encoded as one number."""
    cos, sin = np.cos(middle), np.sin(middle)
    azimuth = np.arctan2(cos * offset[:, 1] - sin * offset[:, 0], cos * offset[:, 0] + sin * offset[:, 1])
    elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
    steps = np.floor(np.stack((azimuth, elevation)) / BIN_RAD).astype(np.int64)
    return np.asarray(steps[0] * 4096 + steps[1], dtype=np.int64)
