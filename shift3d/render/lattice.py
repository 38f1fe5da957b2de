"""A coarse lattice of the field about an object: by how much has the field changed, anywhere, since a rendering?

Source: our choice: the paper renders every step afresh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from shift3d.render.bounds import Box

SPACING_M = 0.45


@dataclass(frozen=True)
class FieldLattice:
    """Distances at multiples of `SPACING_M` in the object frame.

    first: (3,) long, the lowest corner in spacings. g: (nx, ny, nz) float32, metres.
    """

    first: Tensor
    g: Tensor

    @staticmethod
    def of(distance: Callable[[Tensor], Tensor], box: Box) -> FieldLattice:
        """The lattice that holds a box; distance: object-frame points (N, 3) to (N,) metres."""
        first, last = (box.lower / SPACING_M).floor().long(), (box.upper / SPACING_M).ceil().long()
        axes = [SPACING_M * torch.arange(int(a), int(b) + 1, dtype=torch.float64) for a, b in zip(first, last)]
        return FieldLattice(first, distance(torch.cartesian_prod(*axes)).float().reshape([len(axis) for axis in axes]))

    def at(self, x: Tensor) -> Tensor:
        """(N,) float64 trilinear estimate at points (N, 3); outside that of the nearest place inside."""
        last = torch.tensor(self.g.shape) - 1
        # grid_sample wants the last axis of the lattice first.
        grid = (2.0 * (x / SPACING_M - self.first) / last - 1.0).flip(-1).float().reshape(1, 1, 1, -1, 3)
        return functional.grid_sample(self.g[None, None], grid, padding_mode="border", align_corners=True)[
            0, 0, 0, 0
        ].double()

    def unevenness(self, before: FieldLattice, x: Tensor) -> Tensor:
        """(N,) by how much the change since an earlier lattice, which this one holds, differs within a point's cell."""
        change = (self.g - before._stretched_to(self))[None, None]
        most, least = functional.max_pool3d(change, 2, 1), -functional.max_pool3d(-change, 2, 1)
        spread = (most - least)[0, 0]
        cell = (x / SPACING_M - self.first).floor().long()
        cell = torch.minimum(cell.clamp_min(0), torch.tensor(spread.shape) - 1)
        return spread[tuple(cell.unbind(-1))].double()

    def _stretched_to(self, other: FieldLattice) -> Tensor:
        """The distances on another lattice that holds this one, the outermost ones going on."""
        below = (self.first - other.first).tolist()
        above = [n - a - b for n, a, b in zip(other.g.shape, below, self.g.shape)]
        pad = [n for pair in zip(reversed(below), reversed(above)) for n in pair]
        return functional.pad(self.g[None, None], pad, mode="replicate")[0, 0]
