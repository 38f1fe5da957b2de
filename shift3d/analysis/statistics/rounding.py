"""Differences of scores that are nothing but rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROUNDED = 1e-12
"""Differences of scores below it are those of rounding: three replicates of 0.1 have a mean of 0.09999999999999999."""


def without_rounding(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differences (...) with those of rounding as 0: a test of signs would count them as much as any other."""
    return np.where(np.abs(differences) < ROUNDED, 0.0, differences)
