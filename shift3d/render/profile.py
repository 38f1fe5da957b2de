"""What is known of the field along every ray, carried from one rendering to the next.

A search samples the field until the spheres around its samples cover each ray up to its hit. When the shape changes,
these samples need not be taken again: a coarse lattice of the field says what has become of them, roughly, and how
roughly.

Source: our choice: the paper renders every step afresh.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.lattice import FieldLattice
from shift3d.render.seen import Seen

_END_MOVES_M = 0.05
_LEAST_M = 1e-6
# What is expected may be off by such shares of what the change differs by within a cell, and of a sample's own way.
# Measured on attacks of the shipped decoder: with half as much for the first, five times the beams are lost.
_UNEVEN = 0.3
_MOVED = 0.5


@dataclass(frozen=True)
class Profile:
    """S samples on M rays, by ray and range.

    rows: (S,) their rays. k: (S,) float64 ranges. g: (S,) float64 what the field is expected to be there. slack: (S,)
    by how much that may be wrong; 0 where it was measured.
    """

    rows: Tensor
    k: Tensor
    g: Tensor
    slack: Tensor

    @staticmethod
    def none() -> Profile:
        """Nothing known."""
        nothing = torch.empty(0, dtype=torch.float64)
        return Profile(torch.empty(0, dtype=torch.long), nothing, nothing, nothing)

    @staticmethod
    def of(seen: Seen, rows: Tensor, start: int = 0) -> Profile:
        """The finite samples that were seen of some rays, from the start-th on: rows, which they are."""
        local, k, g = (part[start:] for part in seen.samples())
        return Profile(rows[local], k, g, torch.zeros_like(g)).select(torch.isfinite(g))

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, chosen: Tensor) -> Profile:
        """Some of the samples, by number or mask."""
        return Profile(self.rows[chosen], self.k[chosen], self.g[chosen], self.slack[chosen])

    def before(self, end_m: Tensor) -> Profile:
        """The samples in front of a range (M,) of each ray."""
        return self.select(self.k < end_m[self.rows])

    def of_rays(self, chosen: Tensor) -> Profile:
        """The samples of some rays (M,) bool."""
        return self.select(chosen[self.rows])

    def with_more(self, other: Profile) -> Profile:
        """These samples and others, in order; where both have one at the same place, the other one."""
        parts = [torch.cat(pair) for pair in zip(vars(self).values(), vars(other).values(), strict=True)]
        joined = Profile(*parts)
        order = torch.argsort(joined.k, stable=True)
        joined = joined.select(order[torch.argsort(joined.rows[order], stable=True)])
        kept = torch.ones(len(joined), dtype=torch.bool)
        kept[:-1] = (joined.rows[1:] != joined.rows[:-1]) | (joined.k[1:] != joined.k[:-1])
        return joined.select(kept)

    def carried(self, rays: Rays, new_rays: Rays, row_of: Tensor, lattice: FieldLattice, now: FieldLattice) -> Profile:
        """What is expected of the samples in a field that has changed, on rays that may have moved.

        Args:
            rays: that the samples are of. new_rays: as they are now. row_of: (M,) which of the new ones each old one
                is, -1 where it is none.
            lattice, now: of the field then and now.
        """
        row = row_of[self.rows]
        kept = torch.nonzero(row >= 0).squeeze(1)
        old, row = self.select(kept), row[kept]
        # The samples at the ends of a ray stay there.
        k = torch.minimum(torch.maximum(old.k, new_rays.near_m[row]), new_rays.far_m[row])
        then, here = rays.at(old.k, old.rows), new_rays.at(k, row)
        moved = (here - then).norm(dim=-1)
        slack = old.slack + _UNEVEN * now.unevenness(lattice, here) + _MOVED * moved + _LEAST_M
        carried = Profile(row, k, old.g + now.at(here) - lattice.at(then), slack)
        carried = carried.select((k - old.k).abs() < _END_MOVES_M)
        return Profile.none().with_more(carried)
