"""Training scenes with additional vehicles: the scene's own beams are cast at inserted meshes.

Each mesh is another vehicle of the wide family's seen kinds, none from the decoder: attacks search among its shapes.
Returns move onto a vehicle as in the renderer, without noise.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shift3d.geometry.boxes import points_in_boxes
from shift3d.scenes.street.build.fleet import Fleet
from shift3d.scenes.street.build.pool import PoolVehicle
from shift3d.scenes.street.raycast import hit_instance
from shift3d.training.detector_scenes import TrainingScene

TRIES = 40
GROUND_POINTS = 20
CLEARANCE_M = 0.25
VARIANTS = 1 << 20
Floats = npt.NDArray[np.floating]


def with_inserted_vehicles(scene: TrainingScene, fleet: Fleet, rng: np.random.Generator) -> TrainingScene:
    """Insert two to four vehicles 8 to 60 m away, at any heading, clear of other things.

    A beam that meets a vehicle before its own return ends there. A vehicle without a free place is skipped.
    Source: our choice: the paper trains its detectors on recordings alone.
    """
    points, boxes = scene.points, scene.boxes
    origin = np.array((0.0, 0.0, scene.sensor_height_m))
    for _ in range(int(rng.integers(2, 5))):
        variant = int(rng.integers(VARIANTS))
        box = _free_place(points, boxes, np.array(fleet.slot_m(variant)), rng)
        if box is None:
            continue
        points = _cast(points, origin, fleet.vehicle(variant), box)
        boxes = np.concatenate((boxes, box[None].astype(np.float32)))
    return TrainingScene(points, boxes, scene.sensor_height_m)


def _cast(
    points: npt.NDArray[np.float32], origin: npt.NDArray[np.float64], vehicle: PoolVehicle, box: npt.NDArray[np.float64]
) -> npt.NDArray[np.float32]:
    """Return a copy of points (N, 3) where each beam that meets the vehicle before its return ends on the vehicle."""
    offset = points - origin
    range_m = np.linalg.norm(offset, axis=1)
    aims = offset / np.maximum(range_m, 1e-9)[:, None]
    towards = box[:3] - origin
    along = aims @ towards
    near = np.flatnonzero((along > 0.0) & (towards @ towards - along**2 <= vehicle.radius_m**2))
    cos, sin = np.cos(box[6]), np.sin(box[6])
    scene_R_object = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    pose = (scene_R_object, box[:3])
    hit_m, _, _ = hit_instance(vehicle.intersector, *pose, vehicle.glass_band_m, origin, aims[near].astype(np.float32))
    nearer = hit_m < range_m[near]
    moved = points.copy()
    moved[near[nearer]] = origin + aims[near[nearer]] * hit_m[nearer, None]
    return moved


def _free_place(
    points: Floats, boxes: Floats, size_m: npt.NDArray[np.float64], rng: np.random.Generator
) -> npt.NDArray[np.float64] | None:
    """Draw a box on the ground that touches no box and holds no point above the ground; None if all tries fail."""
    for _ in range(TRIES):
        distance, bearing, heading = (rng.uniform(8, 60), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi))
        x, y = distance * np.cos(bearing), distance * np.sin(bearing)
        reach = np.hypot(size_m[0], size_m[1]) / 2
        spread = np.hypot(boxes[:, 0] - x, boxes[:, 1] - y)
        if (spread < reach + np.hypot(boxes[:, 3], boxes[:, 4]) / 2).any():
            continue
        near = points[np.hypot(points[:, 0] - x, points[:, 1] - y) < reach + 1.0]
        if len(near) < GROUND_POINTS:
            continue  # the sensor does not see the ground there
        ground = float(np.percentile(near[:, 2], 10))
        box = np.array((x, y, ground + size_m[2] / 2, *size_m, heading))
        space = box.copy()
        space[2] += CLEARANCE_M
        if not points_in_boxes(near, space[None], margin_m=0.1).any():
            return box
    return None
