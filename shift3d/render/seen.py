"""What a march has seen of each beam on its way to the surface.

Source: our choice: the paper searches every beam afresh.
"""

from __future__ import annotations

import torch
from torch import Tensor


class Seen:
    """The samples of a march, in any order."""

    def __init__(self) -> None:
        self._parts: list[tuple[Tensor, Tensor, Tensor]] = []

    def add(self, rows: Tensor, k: Tensor, g: Tensor) -> None:
        """Samples (n,): of which ray, at which range, and the field there."""
        self._parts.append((rows, k, g))

    def samples(self) -> tuple[Tensor, Tensor, Tensor]:
        """All of them: rows, k, g."""
        if not self._parts:
            nothing = torch.empty(0, dtype=torch.float64)
            return torch.empty(0, dtype=torch.long), nothing, nothing
        rows, k, g = (torch.cat(parts) for parts in zip(*self._parts, strict=True))
        return rows, k, g

    def in_order(self, before: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The finite samples up to a range of each ray, by ray and range.

        Args:
            before: (M,) range.
        Returns: (S,) rows, k, g, and which of these samples are the neighbours before and after each on its ray, the
            sample itself where it has none.
        """
        rows, k, g = self.samples()
        usable = torch.isfinite(g) & (k <= before[rows])
        rows, k, g = rows[usable], k[usable], g[usable]
        order = torch.argsort(k, stable=True)
        order = order[torch.argsort(rows[order], stable=True)]
        rows, k, g = rows[order], k[order], g[order]
        same = torch.zeros(len(rows) + 1, dtype=torch.bool)
        same[1:-1] = rows[1:] == rows[:-1]
        at = torch.arange(len(rows))
        return rows, k, g, at - same[:-1].long(), at + same[1:].long()
