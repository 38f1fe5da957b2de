"""Shapes of the shipped decoder's subspace with known coordinates, as points and as scenes."""

from __future__ import annotations

import functools

import numpy as np
import torch
from numpy.typing import NDArray

from shift3d.retrieval.subspace import Subspace
from shift3d.scenes.scene import Labels, Scene
from shift3d.vehicles.sources import VehicleSet

Array = NDArray[np.float64]
SCALE_M, LENGTH_M = 2.4, 4.5
PER_LENGTH = SCALE_M / LENGTH_M


@functools.cache
def subspace() -> Subspace:
    vehicles = VehicleSet()
    return Subspace.of(vehicles.decoder(), vehicles.codes())


def coordinates(seed: int) -> Array:
    return np.random.default_rng(seed).standard_normal(10)


def surface_points(u: Array, count: int = 300, seed: int = 0) -> Array:
    """Return points on the surface of known coordinates to a tenth of a millimetre, object frame, metres."""
    rng = np.random.default_rng(seed)
    outer = rng.standard_normal((2 * count, 3)) * (0.5, 0.25, 0.2)
    x = torch.from_numpy(outer).float()
    for _ in range(8):
        value, normal, _ = subspace().linearized(u, x)
        x = x - (value / normal.square().sum(1).clamp(min=0.05))[:, None] * normal
    good = (subspace().field(u)(x).abs() < 4e-5) & (x.norm(dim=1) < 0.97)
    return x[good][:count].double().numpy() * SCALE_M


def turned(points: Array, yaw: float) -> Array:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def scene_of(points: Array, box: Array, around: Array | None = None) -> Scene:
    """Return a scene of one labelled vehicle's object-frame points, and other points, seen from the origin."""
    placed = turned(points, box[6]) + box[:3]
    every = placed if around is None else np.concatenate((placed, around))
    return Scene(
        scene_id="by_hand",
        dataset="by_hand",
        points=every.astype(np.float32),
        origins=np.zeros_like(every, dtype=np.float32),
        ground_z_m=-1.7,
        labels=Labels(box[None], ("vehicle",), np.array([len(points)], np.int32), ("Car",)),
    )


def towards(points: Array, sensor: Array, u: Array) -> Array:
    """Return the points of a surface that face a sensor, both in the object frame."""
    _, normal, _ = subspace().linearized(u, torch.from_numpy(points / SCALE_M).float())
    return points[np.einsum("ij,ij->i", normal.double().numpy(), sensor - points) > 0.0]
