"""Height of the ground around the sensor, where a data set does not state it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["estimate_ground_z", "search_ground_z"]

_NEAR_M, _FAR_M = 4.0, 12.0
_BAND_M, _LAYER_M, _REFINED_M = 0.35, 0.05, 0.15
_FEWEST = 500
_LOWEST_M, _HIGHEST_M = -4.0, -0.3  # between a truck's roof and a small robot's


def estimate_ground_z(points: NDArray[np.float32], nominal_z_m: float) -> float:
    """Height of the ground, metres, scene frame, rounded to 1 cm.

    The fullest 5 cm layer between 4 and 12 m from the sensor, within 0.35 m of the nominal height, refined by the
    median of the points within 15 cm of it. With fewer than 500 points there: the nominal height.

    Args:
        points: (N, 3) scene frame, origin at the sensor. nominal_z_m: less the sensor's height above the ground.

    Source: our choice.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    z = points[(distance > _NEAR_M) & (distance < _FAR_M), 2].astype(np.float64)
    z = z[np.abs(z - nominal_z_m) < _BAND_M]
    if len(z) < _FEWEST:
        return nominal_z_m
    layers = round(2.0 * _BAND_M / _LAYER_M)
    counts, edges = np.histogram(z, bins=layers, range=(nominal_z_m - _BAND_M, nominal_z_m + _BAND_M))
    peak = edges[int(counts.argmax())] + _LAYER_M / 2.0
    return round(float(np.median(z[np.abs(z - peak) < _REFINED_M])), 2)


def search_ground_z(points: NDArray[np.float32]) -> float | None:
    """`estimate_ground_z` where the sensor's height is unknown; None where too few points lie below it.

    The nominal height is that of the fullest layer of 0.2 m between 4 and 12 m from the sensor, 0.3 to 4 m below it.

    Args:
        points: (N, 3) scene frame, origin at the sensor.

    Source: our choice.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    z = points[(distance > _NEAR_M) & (distance < _FAR_M), 2]
    counts, edges = np.histogram(z, bins=np.arange(_LOWEST_M, _HIGHEST_M + 0.1, 0.2))
    if counts.sum() < _FEWEST:
        return None
    return estimate_ground_z(points, float(edges[int(counts.argmax())] + 0.1))
