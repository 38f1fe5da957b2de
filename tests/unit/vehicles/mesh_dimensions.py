"""Dimensions of a vehicle measured on its mesh, as a data sheet names them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.errors import InputError

__all__ = ["Dimensions", "measure"]

Array = NDArray[np.float64]
ALONG_M = 0.01
ACROSS_M = 0.02
CONTACT_M = 0.03
LEAST_M = 0.004  # a mesh's facets flatten the very bottom
RADIUS_M = (0.2, 0.6)
TREAD_M = 0.075  # below any body, the lowest of which is 9 cm up


@dataclass(frozen=True)
class Dimensions:
    """Measured dimensions, metres. clearance_m: lowest point of the body between the wheels, above the ground."""

    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    clearance_m: float
    tyre_diameter_m: float


def measure(mesh: trimesh.Trimesh) -> Dimensions:
    """Measure a vehicle that stands on its wheels.

    Args:
        mesh: object frame (x forward, y left, z up), metres; it stands on its lowest point.
    Returns: outer size from the bounds; the others from beams shot up from below, 1 cm apart along x and 2 cm along y.
        The front and rear half each touch the ground in one stretch; a circle through the tread gives axle and tyre.
    Raises: InputError if the mesh does not stand on wheels.
    Source: our choice: definitions of ISO 612 (length, width, height, wheelbase, ground clearance).
    """
    low, high = np.asarray(mesh.bounds)
    x, underside = _underside(mesh, low, high)
    front, rear = (
        _wheel(x[half], underside[half]) for half in (x > (low[0] + high[0]) / 2, x < (low[0] + high[0]) / 2)
    )
    radius = (front[1] + rear[1]) / 2
    between = (x < front[0] - 1.25 * radius) & (x > rear[0] + 1.25 * radius)
    if not between.any() or not np.isfinite(underside[between]).any():
        raise InputError("no body between the wheels", where="vehicle mesh", remedy="a mesh that stands on its wheels")
    length, width, height = high - low
    return Dimensions(
        float(length), float(width), float(height), front[0] - rear[0], float(underside[between].min()), 2.0 * radius
    )


def _underside(mesh: trimesh.Trimesh, low: Array, high: Array) -> tuple[Array, Array]:
    """Return x (A,), and the lowest surface's height above the ground at any y (A,), inf without a surface."""
    x = np.arange(low[0] + ALONG_M / 2, high[0], ALONG_M)
    y = np.arange(low[1] + ACROSS_M / 2, high[1], ACROSS_M)
    at_x, at_y = np.meshgrid(x, y, indexing="ij")
    origins = np.stack((at_x.ravel(), at_y.ravel(), np.full(at_x.size, low[2] - 1.0)), axis=1)
    upwards = np.broadcast_to((0.0, 0.0, 1.0), origins.shape)
    points, beams, _ = mesh.ray.intersects_location(origins, upwards, multiple_hits=False)
    heights = np.full(at_x.size, np.inf)
    heights[beams] = points[:, 2] - low[2]
    return x, heights.reshape(at_x.shape).min(axis=1)


def _wheel(x: Array, underside: Array) -> tuple[float, float]:
    """Return axle x and tyre radius from the lowest profile of one half: a circle on the ground, fitted to the tread.

    A circle of radius r that touches the ground under a: (x - a)^2 + z^2 = 2 r z, linear in (a, a^2, r).
    """
    refused = InputError("no wheel on the ground", where="vehicle mesh", remedy="a mesh that stands on its wheels")
    tread = (underside < TREAD_M) & (underside > LEAST_M)
    if tread.sum() < 4 or not (underside < CONTACT_M).any():
        raise refused
    centre = float(np.mean(x[underside < CONTACT_M]))
    offset, z = x[tread] - centre, underside[tread]
    system = np.stack((2.0 * offset, 2.0 * z, -np.ones_like(z)), axis=1)
    (axle, radius, _), *_ = np.linalg.lstsq(system, offset**2 + z**2, rcond=None)
    if not RADIUS_M[0] < radius < RADIUS_M[1]:
        raise refused
    return centre + float(axle), float(radius)
