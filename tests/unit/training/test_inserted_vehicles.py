"""Inserted vehicles: the label is the mesh's box on the ground, and the points are on the mesh's surface."""

import numpy as np
import trimesh

from shift3d.geometry.boxes import points_in_boxes
from shift3d.geometry.iou import iou_bev
from shift3d.scenes.street.build.fleet import fleet_of
from shift3d.scenes.street.build.item import Size
from shift3d.scenes.street.build.pool import PoolVehicle
from shift3d.scenes.street.raycast import Intersector
from shift3d.training.detector_scenes import TrainingScene
from shift3d.training.inserted_vehicles import with_inserted_vehicles

SIZE_M = (4.4, 1.8, 1.5)


class _Boxes:
    """Fleet whose every vehicle is the same box."""

    def slot_m(self, variant: int) -> Size:
        return SIZE_M

    def vehicle(self, variant: int) -> PoolVehicle:
        mesh = trimesh.creation.box(SIZE_M)
        radius = float(np.linalg.norm(SIZE_M)) / 2 + 0.01
        return PoolVehicle(np.array(SIZE_M), radius, Intersector(mesh.vertices, mesh.faces), (0.0, 0.0))


def _ground_sweep() -> TrainingScene:
    """Return the view of 60 downward beams of a flat ground, and one parked vehicle's box."""
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1000), np.deg2rad(np.linspace(-24, -1.6, 60)))
    distance = (1.8 / np.tan(-elevation)).ravel()
    x, y = distance * np.cos(azimuth.ravel()), distance * np.sin(azimuth.ravel())
    points = np.stack((x, y, np.zeros_like(x)), axis=1).astype(np.float32)
    return TrainingScene(points, np.array([[12, 0, 0.8, 4.5, 1.9, 1.6, 0.0]], dtype=np.float32), 1.8)


def _from_box(points: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return the distance (N,) of points to a box's surface."""
    cos, sin = np.cos(box[6]), np.sin(box[6])
    local = np.abs((points - box[:3]) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])) - box[3:6] / 2
    outside = np.linalg.norm(np.maximum(local, 0.0), axis=1)
    return np.abs(outside + np.minimum(local.max(axis=1), 0.0))


def test_points_lie_on_the_surface_along_their_own_beams_and_nothing_is_touched() -> None:
    scene, added = _ground_sweep(), 0
    origin = np.array((0.0, 0.0, scene.sensor_height_m))
    for seed in range(4):
        result = with_inserted_vehicles(scene, _Boxes(), np.random.default_rng(seed))
        assert np.array_equal(result.boxes[:1], scene.boxes) and 2 <= len(result.boxes) - 1 <= 4
        assert len(result.points) == len(scene.points)
        new = result.boxes[1:].astype(np.float64)
        added += len(new)
        assert np.allclose(new[:, 2] - new[:, 5] / 2, 0.0, atol=0.05)
        overlap = iou_bev(result.boxes, result.boxes) - np.eye(len(result.boxes))
        assert overlap.max() < 1e-6
        moved = np.linalg.norm(result.points - scene.points, axis=1) > 1e-4
        assert moved.sum() > 30
        distances = np.min([_from_box(result.points[moved], box) for box in new], axis=0)
        assert distances.max() < 2e-3
        before, after = scene.points[moved] - origin, result.points[moved] - origin
        shorter = np.linalg.norm(after, axis=1) / np.linalg.norm(before, axis=1)
        assert shorter.max() < 1.0
        np.testing.assert_allclose(after, before * shorter[:, None], atol=1e-3)
        # No remaining beam passes through a vehicle.
        inside = points_in_boxes(result.points, new - np.array((0, 0, 0, 0.02, 0.02, 0.02, 0)))
        assert not inside.any()
    assert added >= 8


def test_what_stands_before_a_vehicle_keeps_its_points() -> None:
    """A wall surrounds the sensor at 7 m: nothing behind it is visible, and the scene stays unchanged."""
    scene = _ground_sweep()
    offset = scene.points - np.array((0.0, 0.0, 1.8))
    wall = np.array((0.0, 0.0, 1.8)) + offset * np.minimum(1.0, 7.0 / np.linalg.norm(offset, axis=1))[:, None]
    # Ground seen through a fence: every second beam passes.
    seen = np.where(np.arange(len(wall))[:, None] % 2 == 0, wall, scene.points).astype(np.float32)
    result = with_inserted_vehicles(TrainingScene(seen, scene.boxes, 1.8), _Boxes(), np.random.default_rng(1))
    assert np.array_equal(result.points[::2], seen[::2])


def test_same_seed_same_scene() -> None:
    fleet = fleet_of("wide", "train")
    one, two = (with_inserted_vehicles(_ground_sweep(), fleet, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.points, two.points) and np.array_equal(one.boxes, two.boxes)
