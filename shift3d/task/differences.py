"""What one rendering of an object gets wrong, held against a better one of the same beams."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

WRONG_SURFACE_M = 0.01
"""A depth that is off by more than this belongs to another surface: nothing of a car is painted that thick."""


@dataclass(frozen=True)
class Differences:
    """Counts over beams; `depth_error_max_m` over the hits on the right surface, 0 where there are none.

    hits: true ones. missed_hits: of these, beams that were left alone. false_hits: beams that were moved without a
    true hit. wrong_surface: hits more than 1 cm from the true one.
    """

    hits: int
    missed_hits: int
    false_hits: int
    wrong_surface: int
    depth_error_max_m: float

    @property
    def none_lost_or_misplaced(self) -> bool:
        """Whether the same beams hit the same surfaces."""
        return self.missed_hits == self.false_hits == self.wrong_surface == 0


def differences(found: tuple[Tensor, Tensor], true: tuple[Tensor, Tensor]) -> Differences:
    """Hold a rendering against the truth. Each: (N,) bool, which beams hit; (N,) float64 ranges, metres."""
    (hit, range_m), (true_hit, true_range_m) = found, true
    error = (range_m - true_range_m).abs()[hit & true_hit]
    right = error <= WRONG_SURFACE_M
    return Differences(
        hits=int(true_hit.sum()),
        missed_hits=int((true_hit & ~hit).sum()),
        false_hits=int((hit & ~true_hit).sum()),
        wrong_surface=int((~right).sum()),
        depth_error_max_m=float(error[right].max()) if bool(right.any()) else 0.0,
    )
