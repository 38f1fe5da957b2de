"""Bird's-eye-view grid of the mean reduction of detection scores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

CELL_SIZE_M = 10.0

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BevGrid:
    """Cells with at least one vehicle, sorted by x, then y of their lower corner (scene frame, metres).

    corner_xy_m: (C, 2) float64. count: (C,) int64 vehicles. mean_before, mean_after: (C,) float64 scores.
    mean_reduction: (C,) float64, mean of before - after.
    """

    corner_xy_m: FloatArray
    count: npt.NDArray[np.int64]
    mean_before: FloatArray
    mean_after: FloatArray
    mean_reduction: FloatArray


def bev_grid(xy_m: npt.ArrayLike, before: npt.ArrayLike, after: npt.ArrayLike) -> BevGrid:
    """Compute the mean reduction of the detection score per cell.

    Args:
        xy_m: (N, 2) position of each vehicle, scene frame, metres. Cell corners are at multiples of `CELL_SIZE_M`; a
            cell includes its lower edges.
        before, after: (N,) scores of the original and of the changed vehicle.

    Raises: ValueError if shapes differ, or a position or score is not finite.

    Source: SHIFT3D fig. bev_score (10 m x 10 m cells, average reduction in detection scores).
    """
    xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
    old, new = np.asarray(before, dtype=np.float64), np.asarray(after, dtype=np.float64)
    if old.shape != (len(xy),) or new.shape != (len(xy),):
        raise ValueError(f"{len(xy)} positions with {old.shape} and {new.shape} scores")
    if not all(np.isfinite(values).all() for values in (xy, old, new)):
        raise ValueError("positions and scores must be finite")
    cells, index = np.unique(np.floor(xy / CELL_SIZE_M).astype(np.int64), axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index, minlength=len(cells)).astype(np.int64)

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(index, weights=values, minlength=len(cells)) / count

    corners = cells.astype(np.float64) * CELL_SIZE_M
    return BevGrid(corners, count, mean(old), mean(new), mean(old - new))
