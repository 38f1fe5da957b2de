"""Calibration of a reference set: distance from each left-out member to the nearest other member."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NATURAL_PERCENTILE = 95.0  # percentile limit: of the left-out members, 95 in 100 are natural by it, and 5 are not
NATURAL_RULE = (
    f"within the {NATURAL_PERCENTILE:g}th percentile of the distances between members of the reference set, of a "
    "published vehicle's sizes, and in one piece"
)
"""Definition of natural, for tables."""
MIN_MEMBERS = 21
"""Least number of members for a calibration: with fewer, even the farthest member is within the 95th percentile."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Distances of left-out members to the nearest other member: mean_cm (K,), p95_cm (K,), see `NearestMember`."""

    mean_cm: NDArray[np.float64]
    p95_cm: NDArray[np.float64]

    def percentile(self, mean_cm: float, p95_cm: float) -> float:
        """Return the percentage of left-out members nearer than a shape: 0 if the shape is nearest, 100 if farthest.

        A shape has two ranks among the members: by the mean, which a body of other proportions raises, and by the 95th
        percentile, which a part of another form raises. The worse rank counts. Members are compared by the same worse
        rank, so that 95 in 100 of them are within the 95th percentile.
        NaN gives 100: an unmeasurable shape counts as farther than all members.
        Source: our choice.
        """
        rank = max(_rank(self._means, mean_cm), _rank(self._p95s, p95_cm))
        # Multiply before dividing: 220 of 400 are 55 per cent, but 100 times 0.55 is more.
        return 100.0 * float(np.searchsorted(self._ranks, rank, side="left")) / len(self._ranks)

    @functools.cached_property
    def _means(self) -> NDArray[np.float64]:
        return np.sort(self.mean_cm)

    @functools.cached_property
    def _p95s(self) -> NDArray[np.float64]:
        return np.sort(self.p95_cm)

    @functools.cached_property
    def _ranks(self) -> NDArray[np.float64]:
        each = zip(self.mean_cm, self.p95_cm)
        return np.sort([max(_rank(self._means, mean), _rank(self._p95s, p95)) for mean, p95 in each])


def _rank(ordered: NDArray[np.float64], value: float) -> float:
    """Return the share of ascending values below `value`; for NaN all."""
    return float(np.searchsorted(ordered, value, side="left")) / len(ordered)
