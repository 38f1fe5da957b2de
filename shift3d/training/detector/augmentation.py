"""One random training crop of a scene: where it is cut, how it is turned, and how its sensor is varied.

The sensor variations (lost points, coarser beams, range noise, ground height and slope) are our choice: the
same weights must work on both procedural sensors and on real frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np
import numpy.typing as npt

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid
from shift3d.geometry.boxes import points_in_boxes
from shift3d.training.detector_scenes import TrainingScene

__all__ = ["Crop", "random_crop", "window_around"]

Floats = npt.NDArray[np.float32]
STRIDE = 4
FEW_POINTS = 5
VEHICLE_RADIUS_M = 60.0


@dataclass(frozen=True)
class Crop:
    """points (N, 3) and boxes (M, 7) float32, network frame; usable (M,): boxes with enough points."""

    points: Floats
    boxes: Floats
    usable: npt.NDArray[np.bool_]
    window: BevWindow


def window_around(grid: Grid, centre_xy: tuple[float, float], cells: int) -> BevWindow:
    """A square window near a centre, aligned to the stride, inside the grid; the core is all of it."""
    starts = []
    for centre, origin, count in (
        (centre_xy[0], grid.x_min_m, grid.num_x),
        (centre_xy[1], grid.y_min_m, grid.num_y),
    ):
        start = round(((centre - origin) / grid.cell_m - cells / 2) / STRIDE) * STRIDE
        starts.append(int(np.clip(start, 0, count - cells)))
    x0, y0 = starts
    return BevWindow(x0, y0, cells, cells, x0, y0, cells, cells)


def random_crop(scene: TrainingScene, grid: Grid, cells: int, rng: np.random.Generator, jitter_m: float = 11.0) -> Crop:
    """Cut, turn and vary. The same rng state gives the same crop.

    cells: side of the square window. jitter_m: how far its centre lies from a vehicle at most, in x and y.
    """
    angle, flip = rng.uniform(-np.pi, np.pi), rng.random() < 0.5
    scale = rng.uniform(0.92, 1.08)
    centre = _centre(scene, jitter_m, rng)
    reach = (hypot(cells, cells) / 2 * grid.cell_m + 4.0) / scale
    near = np.hypot(scene.points[:, 0] - centre[0], scene.points[:, 1] - centre[1]) < reach
    points = _thinned(scene.points[near], scene.sensor_height_m, rng)
    boxes = scene.boxes[np.hypot(scene.boxes[:, 0] - centre[0], scene.boxes[:, 1] - centre[1]) < reach + 4.0]
    points = points[_not_lost_on_vehicles(points, boxes, rng)]
    points, boxes = _moved(points, boxes, angle, flip, scale, rng)
    turned = scale * _turn(np.array([[centre[0], centre[1] * (-1 if flip else 1)]]), angle)[0]
    window = window_around(grid, (turned[0], turned[1]), cells)
    counts = points_in_boxes(points, boxes).sum(axis=1)
    return Crop(points, boxes, counts >= FEW_POINTS, window)


def _centre(scene: TrainingScene, jitter_m: float, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Near a vehicle mostly, anywhere sometimes: crops without any vehicle teach what is none."""
    near = scene.boxes[np.hypot(scene.boxes[:, 0], scene.boxes[:, 1]) < VEHICLE_RADIUS_M]
    if len(near) and rng.random() < 0.85:
        return np.asarray(near[rng.integers(len(near)), :2] + rng.uniform(-jitter_m, jitter_m, 2), dtype=np.float64)
    return rng.uniform(-45, 45, 2)


def _thinned(points: Floats, sensor_height_m: float, rng: np.random.Generator) -> Floats:
    """Lose points at random, sometimes whole beams, and add noise along the beam."""
    keep = np.ones(len(points), dtype=bool)
    if rng.random() < 0.5:
        keep &= rng.random(len(points)) < rng.uniform(0.6, 1.0)
    offset = points - np.array((0, 0, sensor_height_m), dtype=np.float32)
    if rng.random() < 0.2:
        elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
        beam = np.floor(elevation / np.deg2rad(rng.uniform(0.25, 0.6)) + rng.random()).astype(np.int64)
        every = int(rng.integers(2, 4))
        keep &= (beam % every == 0) if rng.random() < 0.5 else (beam % every != 0)
    points, offset = points[keep], offset[keep]
    length = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-3)
    noise = rng.normal(0.0, rng.uniform(0.0, 0.03), (len(points), 1)).astype(np.float32)
    return np.asarray(points + offset / length * noise, dtype=np.float32)


def _not_lost_on_vehicles(points: Floats, boxes: Floats, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Which points stay when glass or dark paint swallows part of some vehicles' returns."""
    stays = np.ones(len(points), dtype=bool)
    for box in boxes:
        if rng.random() > 0.3:
            continue
        inside = np.flatnonzero(points_in_boxes(points, box[None])[0])
        above = points[inside, 2] > box[2] + box[5] * rng.uniform(-0.1, 0.3)
        chance = np.where(above, rng.uniform(0.0, 1.0), rng.uniform(0.0, 0.5))
        stays[inside[rng.random(len(inside)) < chance]] = False
    return stays


def _turn(xy: npt.NDArray[np.floating], angle_rad: float) -> npt.NDArray[np.float64]:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack((cos * xy[:, 0] - sin * xy[:, 1], sin * xy[:, 0] + cos * xy[:, 1]), axis=1)


def _moved(
    points: Floats, boxes: Floats, angle: float, flip: bool, scale: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Mirror, turn about the sensor, scale, shift, and tilt the ground."""
    points, boxes = points.copy(), boxes.copy()
    shift = np.array((*rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.15, 0.15)))
    slope = rng.uniform(-0.015, 0.015, 2) if rng.random() < 0.5 else np.zeros(2)
    if flip:
        points[:, 1] *= -1
        boxes[:, 1] *= -1
        boxes[:, 6] *= -1
    for array in (points, boxes):
        array[:, :2] = _turn(array[:, :2], angle)
        array[:, :3] = array[:, :3] * scale + shift
        array[:, 2] += array[:, :2] @ slope.astype(np.float32)
    boxes[:, 3:6] *= scale
    boxes[:, 6] = np.mod(boxes[:, 6] + angle + np.pi, 2 * np.pi) - np.pi
    return points, boxes
