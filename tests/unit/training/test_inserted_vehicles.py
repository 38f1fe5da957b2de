"""Rendered insertions: the label is the box of the surface, on the ground, and the points lie on it."""

import numpy as np
import torch
from torch import Tensor

from shift3d.geometry.boxes import points_in_boxes
from shift3d.geometry.iou import iou_bev
from shift3d.training.detector_scenes import TrainingScene
from shift3d.training.inserted_vehicles import InsertableVehicle, with_inserted_vehicles
from shift3d.vehicles.vehicle import Vehicle

HALF_M = torch.tensor([2.2, 0.9, 0.75])
OFFSET_M = torch.tensor([0.2, -0.1, 0.15])  # the surface's centre, away from the object's origin
SCALE_M = 2.5


class _BoxShape:
    """A shape decoder whose every code is the same box."""

    def field(self, z: Tensor) -> "_BoxShape":
        return self

    def __call__(self, x_sdf: Tensor) -> Tensor:
        q = (x_sdf * SCALE_M - OFFSET_M.to(x_sdf.dtype)).abs() - HALF_M.to(x_sdf.dtype)
        outside = q.clamp(min=0).norm(dim=1)
        return (outside + q.amax(dim=1).clamp(max=0)) / SCALE_M


def _vehicle() -> InsertableVehicle:
    size = tuple(float(2 * half) for half in HALF_M)
    extent = tuple(s + 1.0 for s in size)
    vehicle = Vehicle("box", "van", np.zeros(256, np.float32), SCALE_M, np.eye(3), np.zeros(3), extent)
    return InsertableVehicle(vehicle, OFFSET_M.double().numpy(), np.array(size))


def _ground_sweep() -> TrainingScene:
    """What 60 downward beams see of a flat ground, and one parked vehicle's box."""
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1000), np.deg2rad(np.linspace(-24, -1.6, 60)))
    distance = (1.8 / np.tan(-elevation)).ravel()
    x, y = distance * np.cos(azimuth.ravel()), distance * np.sin(azimuth.ravel())
    points = np.stack((x, y, np.zeros_like(x)), axis=1).astype(np.float32)
    return TrainingScene(points, np.array([[12, 0, 0.8, 4.5, 1.9, 1.6, 0.0]], dtype=np.float32), 1.8)


def test_boxes_hold_their_points_and_touch_nothing() -> None:
    scene, added = _ground_sweep(), 0
    for seed in range(4):
        result = with_inserted_vehicles(scene, [_vehicle()], _BoxShape(), np.random.default_rng(seed))
        assert np.array_equal(result.boxes[:1], scene.boxes) and 2 <= len(result.boxes) - 1 <= 4
        assert len(result.points) == len(scene.points)
        new = result.boxes[1:]
        added += len(new)
        assert np.allclose(new[:, 2] - new[:, 5] / 2, 0.0, atol=0.05)
        overlap = iou_bev(result.boxes, result.boxes) - np.eye(len(result.boxes))
        assert overlap.max() < 1e-6
        moved = np.linalg.norm(result.points - scene.points, axis=1) > 1e-4
        assert moved.sum() > 30
        assert points_in_boxes(result.points[moved], new, margin_m=0.02).any(axis=0).all()
    assert added >= 8


def test_same_seed_same_scene() -> None:
    one, two = (
        with_inserted_vehicles(_ground_sweep(), [_vehicle()], _BoxShape(), np.random.default_rng(3)) for _ in range(2)
    )
    assert np.array_equal(one.points, two.points) and np.array_equal(one.boxes, two.boxes)
