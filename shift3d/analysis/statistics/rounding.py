"""Removal of score differences that are only rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROUNDED = 1e-12  # Smaller score differences are rounding: three replicates of 0.1 have a mean of 0.09999999999999999.


def without_rounding(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Set differences (...) at rounding level to 0, because a sign test would count them like any other difference."""
    return np.where(np.abs(differences) < ROUNDED, 0.0, differences)
