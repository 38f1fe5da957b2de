"""Random training crops of a scene: the centre, the window of the grid, and augmentation.

Sensor effects (lost points, coarser beams, noise) and the ground's height and slope vary, so that the same weights work
on both procedural sensors and on real frames (our choice). See `recipe.Augmentation` for the fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import hypot

import numpy as np
import numpy.typing as npt
import torch

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, cells_of
from shift3d.geometry.boxes import points_in_boxes
from shift3d.training.detector.pasting import VehicleDatabase, pasted
from shift3d.training.detector.recipe import Augmentation, Recipe
from shift3d.training.detector_scenes import MARGIN_M, TrainingScene

Floats = npt.NDArray[np.float32]
STRIDE = 4
TRIES = 6
LINE_SPACING_DEG = (0.25, 0.6)


@dataclass(frozen=True)
class Crop:
    """Points (N, 3) and boxes (M, 7) float32, network frame; usable (M,): boxes with enough points."""

    points: Floats
    boxes: Floats
    usable: npt.NDArray[np.bool_]
    window: BevWindow

    def points_inside(self, grid: Grid) -> Floats:
        """Return the points inside the window and the grid's height range."""
        _, _, inside = cells_of(torch.from_numpy(self.points), grid, self.window)
        return self.points[inside]


def window_around(grid: Grid, centre_xy: tuple[float, float], cells: int) -> BevWindow:
    """Return a square window near a centre, aligned to the stride, inside the grid; its core is the whole window."""
    starts = []
    for centre, origin, count in ((centre_xy[0], grid.x_min_m, grid.num_x), (centre_xy[1], grid.y_min_m, grid.num_y)):
        start = round(((centre - origin) / grid.cell_m - cells / 2) / STRIDE) * STRIDE
        starts.append(int(np.clip(start, 0, count - cells)))
    x0, y0 = starts
    return BevWindow(x0, y0, cells, cells, x0, y0, cells, cells)


def _pushed_m(grid: Grid, centre_xy: tuple[float, float], cells: int) -> float:
    """Compute the distance by which the grid's edge pushes the middle of `window_around` off the centre."""
    half = cells / 2 * grid.cell_m
    ends = ((grid.x_min_m, grid.num_x), (grid.y_min_m, grid.num_y))
    inside = [(low + half, low + count * grid.cell_m - half) for low, count in ends]
    return hypot(*(max(low - at, at - high, 0.0) for at, (low, high) in zip(centre_xy, inside, strict=True)))


def random_crop(
    scene: TrainingScene,
    grid: Grid,
    recipe: Recipe,
    rng: np.random.Generator,
    database: VehicleDatabase | None = None,
    around: npt.NDArray[np.float64] | None = None,
) -> Crop:
    """Cut a crop, paste vehicles into it and augment it. The same rng state gives the same crop.

    recipe: only the crop and augmentation fields are read. database: vehicles to paste; None: nothing is pasted.
    around: (x, y) near which the crop is cut; None: near a vehicle, or anywhere.
    """
    augmentation, cells = recipe.augmentation, recipe.crop_cells
    angle, scale = rng.uniform(*augmentation.turn_rad), rng.uniform(*augmentation.scale)
    flip = rng.random() < augmentation.flip
    centre = _centre(scene, recipe, rng) if around is None else _near(around, recipe, rng)
    y = -centre[1] if flip else centre[1]
    turned = (
        scale * (np.cos(angle) * centre[0] - np.sin(angle) * y),
        scale * (np.sin(angle) * centre[0] + np.cos(angle) * y),
    )
    reach = (hypot(cells, cells) / 2 * grid.cell_m + 4.0 + _pushed_m(grid, turned, cells)) / scale
    if database is not None and augmentation.pasted:
        side = cells / 2 * grid.cell_m
        scene = pasted(scene, database, centre, side, augmentation, recipe.min_points, rng)
    near = np.hypot(scene.points[:, 0] - centre[0], scene.points[:, 1] - centre[1]) < reach
    points = drop_points(scene.points[near], scene.sensor_height_m, augmentation, rng)
    boxes = scene.boxes[np.hypot(scene.boxes[:, 0] - centre[0], scene.boxes[:, 1] - centre[1]) < reach + 4.0]
    points, boxes = augment_vehicles(points, boxes, augmentation, rng)
    points, boxes = moved(points, boxes, (angle, flip, scale), augmentation, rng)
    counts = points_in_boxes(points, boxes).sum(axis=1)
    return Crop(points, boxes, counts >= recipe.min_points, window_around(grid, turned, cells))


def _centre(scene: TrainingScene, recipe: Recipe, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Draw a place, mostly near a vehicle, sometimes anywhere up to the farthest range bin, to teach the background."""
    if rng.random() >= recipe.empty_share:
        vehicle = vehicle_centre(scene, recipe.augmentation.range_bins_m, recipe.min_points, rng)
        if vehicle is not None:
            return _near(vehicle, recipe, rng)
    farthest = recipe.augmentation.range_bins_m[-1]
    return rng.uniform(-farthest, farthest, 2)


def _near(place: npt.NDArray[np.float64], recipe: Recipe, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    return place + rng.uniform(-recipe.jitter_m, recipe.jitter_m, 2)


def vehicle_centre(
    scene: TrainingScene, bins_m: tuple[float, ...], min_points: int, rng: np.random.Generator
) -> npt.NDArray[np.float64] | None:
    """Draw the (x, y) of a visible vehicle, each non-empty range bin with equal probability; None if there is none.

    bins_m: ascending edges. A vehicle with too few points is replaced by another draw, at most TRIES times.
    """
    range_m = np.hypot(scene.boxes[:, 0], scene.boxes[:, 1])
    bins = [np.flatnonzero((range_m >= low) & (range_m < high)) for low, high in pairwise(bins_m)]
    for _ in range(TRIES):
        filled = [rows for rows in bins if len(rows)]
        if not filled:
            return None
        rows = filled[int(rng.integers(len(filled)))]
        row = rows[int(rng.integers(len(rows)))]
        if points_in_boxes(scene.points, scene.boxes[row : row + 1]).sum() >= min_points:
            return np.asarray(scene.boxes[row, :2], dtype=np.float64)
        bins = [kept[kept != row] for kept in bins]
    return None


def drop_points(points: Floats, sensor_height_m: float, augmentation: Augmentation, rng: np.random.Generator) -> Floats:
    """Drop points at random, sometimes whole scan lines, and add noise along the beam."""
    keep = np.ones(len(points), dtype=bool)
    if rng.random() < 0.5:
        keep &= rng.random(len(points)) < rng.uniform(*augmentation.kept_points)
    offset = points - np.array((0, 0, sensor_height_m), dtype=np.float32)
    if rng.random() < augmentation.dropped_lines:
        elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
        line = np.floor(elevation / np.deg2rad(rng.uniform(*LINE_SPACING_DEG)) + rng.random()).astype(np.int64)
        every = int(rng.integers(augmentation.kept_line_in[0], augmentation.kept_line_in[1] + 1))
        keep &= (line % every == 0) if rng.random() < 0.5 else (line % every != 0)
    points, offset = points[keep], offset[keep]
    length = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-3)
    noise = rng.normal(0.0, rng.uniform(*augmentation.range_noise_m), (len(points), 1)).astype(np.float32)
    return np.asarray(points + offset / length * noise, dtype=np.float32)


def augment_vehicles(
    points: Floats, boxes: Floats, augmentation: Augmentation, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Scale and stretch each vehicle with its points about the middle of its bottom face; drop returns of some."""
    points, boxes = points.copy(), boxes.copy()
    stays = np.ones(len(points), dtype=bool)
    least, most = np.reshape(augmentation.object_stretch, (-1, 2)).T
    for row, inside in enumerate(points_in_boxes(points, boxes, MARGIN_M)):
        on_it, box = np.flatnonzero(inside), boxes[row].copy()
        factor = rng.uniform(*augmentation.object_scale) * rng.uniform(least, most, 3)
        bottom = np.array((box[0], box[1], box[2] - box[5] / 2), dtype=np.float32)
        cos, sin = np.cos(box[6]), np.sin(box[6])
        axes = np.array(((cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)))  # rows: length, width, height
        points[on_it] = bottom + (points[on_it] - bottom) @ (axes.T * factor @ axes).astype(np.float32)
        boxes[row, 3:6] *= factor
        boxes[row, 2] = bottom[2] + boxes[row, 5] / 2
        if rng.random() < augmentation.swallowed:
            above = points[on_it, 2] > boxes[row, 2] + boxes[row, 5] * rng.uniform(-0.1, 0.3)
            chance = np.where(above, rng.uniform(0.0, 1.0), rng.uniform(0.0, 0.5))
            stays[on_it[rng.random(len(on_it)) < chance]] = False
    return points[stays], boxes


def moved(
    points: Floats, boxes: Floats, move: tuple[float, bool, float], augmentation: Augmentation, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Mirror, rotate about the sensor, scale, shift, and tilt the ground. move: (angle, mirrored, scale)."""
    angle, flip, scale = move
    points, boxes = points.copy(), boxes.copy()
    aside = rng.uniform(-augmentation.shift_m, augmentation.shift_m, 2)
    shift = np.array((*aside, rng.uniform(*augmentation.ground_shift_m)))
    steepest = augmentation.ground_slope if rng.random() < 0.5 else 0.0
    slope = rng.uniform(-steepest, steepest, 2)
    if flip:
        points[:, 1] *= -1
        boxes[:, 1] *= -1
        boxes[:, 6] *= -1
    cos, sin = np.cos(angle), np.sin(angle)
    for array in (points, boxes):
        array[:, :2] = array[:, :2] @ np.array(((cos, sin), (-sin, cos)), dtype=np.float64)
        array[:, :3] = array[:, :3] * scale + shift
        array[:, 2] += array[:, :2] @ slope.astype(np.float32)
    boxes[:, 3:6] *= scale
    boxes[:, 6] = np.mod(boxes[:, 6] + angle + np.pi, 2 * np.pi) - np.pi
    return points, boxes
