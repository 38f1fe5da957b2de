"""Removal of differences that are only rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DECIMALS = 12  # Later decimals of scores are rounding: three replicates of 0.1 have a mean of 0.09999999999999999.
ROUNDED = 10.0**-DECIMALS


def without_rounding(values: NDArray[np.float64], exact: float = 0.0) -> NDArray[np.float64]:
    """Set values (...) that differ from `exact` at rounding level to `exact`.

    A sign test would count such score differences like any other difference.
    """
    return np.where(np.abs(values - exact) < ROUNDED * max(1.0, abs(exact)), exact, values)
