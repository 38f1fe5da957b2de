"""Ground around a sensor: height estimated from a scene's points, and map of heights and drivable cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.file_checks import require_array

_NEAR_M, _FAR_M = 4.0, 12.0
_BAND_M, _LAYER_M, _REFINED_M = 0.35, 0.05, 0.15
_FEWEST = 500
_LOWEST_M, _HIGHEST_M = -4.0, -0.4  # between a truck's roof and a small robot's


def estimate_ground_z(points: NDArray[np.float32], nominal_z_m: float) -> float:
    """Estimate the height of the ground, metres, scene frame, rounded to 1 cm.

    Finds the fullest 5 cm layer between 4 and 12 m from the sensor within 0.35 m of the nominal height. Returns the
    median of the points within 15 cm of that layer, or the nominal height below 500 points. Source: our choice.

    Args:
        points: (N, 3) scene frame, origin at the sensor. nominal_z_m: minus the sensor's height above the ground.
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
    """Run `estimate_ground_z` without a known sensor height. Returns None if too few points lie below the sensor.

    The nominal height is that of the fullest layer of 0.2 m between 4 and 12 m from the sensor, 0.4 to 4 m below it.
    points: (N, 3) scene frame, origin at the sensor. Source: our choice.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    z = points[(distance > _NEAR_M) & (distance < _FAR_M), 2]
    counts, edges = np.histogram(z, bins=np.arange(_LOWEST_M, _HIGHEST_M + 0.1, 0.2))
    if counts.sum() < _FEWEST:
        return None
    return estimate_ground_z(points, float(edges[int(counts.argmax())] + 0.1))


Float = NDArray[np.float64]

CELL_M, CELLS = 0.5, 240  # 60 m each way: placements lie within 50 m


@dataclass(frozen=True)
class GroundMap:
    """Grid of 0.5 m cells around the scene's origin: cell [i, j] starts at x = i / 2 - 60, y = j / 2 - 60 metres.

    Attributes:
        height_m: (240, 240) float32, scene frame; NaN if the map has no height.
        drivable: (240, 240) bool, vehicles drive or park in the cell; None: the map does not state it.

    Source: our choice.
    """

    height_m: NDArray[np.float32]
    drivable: NDArray[np.bool_] | None = None

    @staticmethod
    def of(ground: Float, areas: Sequence[Float] | None) -> GroundMap:
        """Build the map from ground points (N, 3) and outlines (V, 2 or 3) of drivable areas, scene frame, metres.

        A cell's height is the mean of its points. A cell is drivable if its centre is inside an outline.
        """
        ground = ground[np.isfinite(ground).all(axis=1)]
        at = np.floor(ground[:, :2] / CELL_M).astype(np.int64) + CELLS // 2
        inside = ((at >= 0) & (at < CELLS)).all(axis=1)
        cell = at[inside] @ (CELLS, 1)
        counts = np.bincount(cell, minlength=CELLS**2)
        sums = np.bincount(cell, ground[inside, 2], minlength=CELLS**2)
        height = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).astype(np.float32)
        height = height.reshape(CELLS, CELLS)
        if areas is None:
            return GroundMap(height)
        drivable = np.zeros((CELLS, CELLS), dtype=np.bool_)
        for outline in areas:
            drivable |= _filled(outline[:, :2])
        return GroundMap(height, drivable)

    def height_at(self, x_m: float, y_m: float) -> float | None:
        """Return the height of the ground, scene frame, metres; None if the map has none."""
        cell = _cell(x_m, y_m)
        return float(self.height_m[cell]) if cell and math.isfinite(self.height_m[cell]) else None

    def allows(self, x_m: float, y_m: float) -> bool:
        """True if the map says that the position is drivable, or has no drivable areas."""
        cell = _cell(x_m, y_m)
        return self.drivable is None or (cell is not None and bool(self.drivable[cell]))

    def validate(self, where: str) -> None:
        """Refuse grids of another shape or type. Raises InputError: naming the field."""
        require_array(self.height_m, (CELLS, CELLS), np.float32, f"{where}, ground_map.height_m")
        if self.drivable is not None:
            require_array(self.drivable, (CELLS, CELLS), np.bool_, f"{where}, ground_map.drivable")


def _cell(x_m: float, y_m: float) -> tuple[int, int] | None:
    row, column = (math.floor(metres / CELL_M) + CELLS // 2 for metres in (x_m, y_m))
    return (row, column) if 0 <= row < CELLS and 0 <= column < CELLS else None


def _filled(outline: Float) -> NDArray[np.bool_]:
    """Mark the cells (240, 240) with centres inside a closed outline (V, 2), by the even-odd rule."""
    inside = np.zeros((CELLS, CELLS), dtype=np.bool_)
    middle = (np.arange(CELLS) + 0.5 - CELLS // 2) * CELL_M
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        rows = np.flatnonzero((middle < x0) != (middle < x1))
        if len(rows):
            crossing = y0 + (middle[rows] - x0) / (x1 - x0) * (y1 - y0)
            inside[rows] ^= middle > crossing[:, None]
    return inside
