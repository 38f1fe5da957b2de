"""Samples of the field along rays, measured or predicted, each with an error bound.

A search leaves samples whose free spheres cover each ray. For the next rendering, of a changed shape, two coarse grids
predict the change at each sample with an error bound, so that most samples need no new evaluation.

Source: our choice: the paper renders every step from scratch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from shift3d.render.culling import Rays, take
from shift3d.render.field.sdf_grid import SdfGrid

_END_MOVES_M = 0.05
_LEAST_ERROR_M = 1e-6
_LONGEST_M = 4096.0


@dataclass(frozen=True)
class RaySamples:
    """S samples of the field on M rays.

    rows: (S,) their rays. k: (S,) float64 ranges. g: (S,) float64 metric distance, metres. error: (S,) float64 error
    bound of g, metres; 0 if g was measured.
    """

    rows: Tensor
    k: Tensor
    g: Tensor
    error: Tensor

    @staticmethod
    def none() -> RaySamples:
        """Return an empty set of samples."""
        nothing = torch.empty(0, dtype=torch.float64)
        return RaySamples(torch.empty(0, dtype=torch.long), nothing, nothing, nothing)

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, chosen: Tensor) -> Self:
        """Select samples by number or mask."""
        return type(self)(*take(vars(self).values(), chosen))

    @classmethod
    def stacked(cls, parts: Sequence[Self]) -> Self:
        """Concatenate samples without sorting them."""
        return cls(*(torch.cat(some) for some in zip(*(vars(part).values() for part in parts), strict=True)))

    def of_rays(self, chosen: Tensor) -> Self:
        """Select the samples of the chosen rays (M,) bool."""
        return self.select(chosen[self.rows])

    def on(self, rows: Tensor) -> Self:
        """Return the samples with the ray numbers 0 to M - 1 replaced by rows (M,)."""
        return replace(self, rows=rows[self.rows])

    def before(self, end_m: Tensor) -> RaySamples:
        """Select the samples in front of a range (M,) of each ray."""
        return self.select(self.k < end_m[self.rows])

    def thinned(self, spacing_m: float) -> RaySamples:
        """Keep the lowest sample of every stretch; a stretch is `spacing_m` long, or longer where g is larger."""
        level = (self.g / (2 * spacing_m)).clamp_min(1.0).log2().floor()
        cell = (self.k / (spacing_m * 2.0**level)).floor()
        order = torch.argsort(self.g, stable=True)
        for key in (cell, level, self.rows):
            order = order[torch.argsort(key[order], stable=True)]
        first = torch.ones(len(self), dtype=torch.bool)
        first[1:] = torch.stack([key[order][1:] != key[order][:-1] for key in (cell, level, self.rows)]).any(0)
        kept = self.select(order[first])
        return kept.select(by_ray_and_range(kept.rows, kept.k))

    def joined(self, other: RaySamples) -> RaySamples:
        """Merge with other samples, in order; at equal positions the other sample wins."""
        both = RaySamples.stacked([self, other])
        both = both.select(by_ray_and_range(both.rows, both.k))
        kept = torch.ones(len(both), dtype=torch.bool)
        kept[:-1] = (both.rows[1:] != both.rows[:-1]) | (both.k[1:] != both.k[:-1])
        return both.select(kept)

    def predicted(
        self, rays: Rays, new_rays: Rays, row_of: Tensor, then: SdfGrid, now: SdfGrid, share: float
    ) -> RaySamples:
        """Predict the samples for a field that has changed, on rays that may have moved.

        Args:
            rays: rays of the samples. new_rays: rays of the new rendering. row_of: (M,) new ray of each old one, -1 if
                none.
            then, now: coarse grids of the old and the new field, over one box.
            share: error bound of a prediction, as a share of the change's variation within a grid cell and of the
                sample's own motion; see `RenderSettings.prediction_error`.
        """
        row = row_of[self.rows]
        kept = torch.nonzero(row >= 0).squeeze(1)
        old, row = self.select(kept), row[kept]
        # A sample beyond the end of its new ray moves to that end.
        k = torch.minimum(torch.maximum(old.k, new_rays.near_m[row]), new_rays.far_m[row])
        before, after = rays.at(old.k, old.rows), new_rays.at(k, row)
        moved = (after - before).norm(dim=-1)
        error = old.error + share * (now.of_cells(after, now.variation(then)) + moved) + _LEAST_ERROR_M
        predicted = RaySamples(row, k, old.g + (now.at(after) - then.at(before)).double(), error)
        return RaySamples.none().joined(predicted.select((k - old.k).abs() < _END_MOVES_M))


def by_ray_and_range(rows: Tensor, k: Tensor) -> Tensor:
    """Return (S,) the stable order of samples by ray, and by range on each ray (to 0.1 um)."""
    return torch.argsort(rows * _LONGEST_M + k, stable=True)
