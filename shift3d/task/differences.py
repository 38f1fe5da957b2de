"""Errors of a rendering, measured against a more accurate rendering of the same beams."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

WRONG_SURFACE_M = 0.01
"""A larger depth error belongs to another surface: no coat of paint on a car is that thick."""


@dataclass(frozen=True)
class Differences:
    """Error counts over beams; `depth_error_max_m` over the hits on the right surface, 0 without such hits.

    hits: true hits. missed_hits: true hits that the rendering did not move. false_hits: beams moved without a true hit.
    wrong_surface: hits more than 1 cm from the true one.
    """

    hits: int
    missed_hits: int
    false_hits: int
    wrong_surface: int
    depth_error_max_m: float

    @property
    def all_hits_agree(self) -> bool:
        """True if the same beams hit the same surfaces."""
        return self.missed_hits == self.false_hits == self.wrong_surface == 0


def differences(found: tuple[Tensor, Tensor], true: tuple[Tensor, Tensor]) -> Differences:
    """Compare a rendering with the truth. Each: (N,) bool hit mask, and (N,) float64 ranges, metres."""
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
