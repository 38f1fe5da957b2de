"""Scans of sloping ground with objects on it, in closed form."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
SENSOR_M = 1.73


def slope_scan(slope_x: float, slope_y: float, rings: int = 64, columns: int = 900) -> Array:
    """Return (N, 3) float64 returns of a spinning sensor over z = slope_x x + slope_y y - 1.73, within 60 m."""
    elevation, azimuth = np.deg2rad(np.linspace(-24.0, 6.0, rings)), np.linspace(-np.pi, np.pi, columns, endpoint=False)
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    ray = np.stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), -1).reshape(-1, 3)
    falls = ray @ (slope_x, slope_y, -1.0)
    reach = np.where(falls > 1e-6, SENSOR_M / np.maximum(falls, 1e-6), np.inf)
    return ray[reach < 60.0] * reach[reach < 60.0, None]


def patch(
    centre: tuple[float, float], slopes: tuple[float, float], count: int, noise_m: float = 0.0, seed: int = 0
) -> Array:
    """Return (count, 3) points within 3 m of a place, on the plane through it at height -1.73, with noise of height."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3.0, 3.0, (count, 2))
    return np.column_stack((xy + centre, xy @ slopes - SENSOR_M + rng.normal(0.0, 1.0, count) * noise_m))


def raised(points: Array, by_m: float) -> Array:
    """Return the points, raised."""
    return points + np.array([0.0, 0.0, by_m])
