"""How a training crop differs from its scene: lost points and scan lines, range noise, sizes, place and ground.

What a sensor does (lost points, coarser beams, noise) and the height and slope of the ground are varied so that the
same weights work on both procedural sensors and on real frames (our choice). See `recipe.Augmentation` for the fields.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shift3d.geometry.boxes import points_in_boxes
from shift3d.training.detector.recipe import Augmentation

Floats = npt.NDArray[np.float32]
MARGIN_M = 0.1  # mirrors and antennas stand out of a box
LINE_SPACING_DEG = (0.25, 0.6)


def thinned(points: Floats, sensor_height_m: float, augmentation: Augmentation, rng: np.random.Generator) -> Floats:
    """Lose points at random, sometimes whole scan lines, and add noise along the beam."""
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


def vehicles_varied(
    points: Floats, boxes: Floats, augmentation: Augmentation, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Scale and stretch each vehicle with its points about the middle of its bottom face; take returns from some."""
    points, boxes = points.copy(), boxes.copy()
    stays = np.ones(len(points), dtype=bool)
    for row, inside in enumerate(points_in_boxes(points, boxes, MARGIN_M)):
        on_it, box = np.flatnonzero(inside), boxes[row].copy()
        factor = rng.uniform(*augmentation.object_scale) * rng.uniform(*augmentation.object_stretch, 3)
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
    """Mirror, turn about the sensor, scale, shift, and tilt the ground. move: (angle, mirrored, scale)."""
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
