"""What a march has seen of each beam on its way to the surface: where the way down slackens.

Source: our choice: the paper searches every beam afresh.
"""

from __future__ import annotations

import torch
from torch import Tensor

SLACK = 0.5
"""A sample whose g is less than this share of what is left to the crossing lies on a shelf, not on the way down."""


class Seen:
    """The samples of a march, in any order."""

    def __init__(self) -> None:
        self._parts: list[tuple[Tensor, Tensor, Tensor]] = []

    def add(self, rows: Tensor, k: Tensor, g: Tensor) -> None:
        """Samples (n,): of which ray, at which range, and the field there."""
        self._parts.append((rows, k, g))

    def in_order(self, before: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The finite samples up to a range of each ray, by ray and range.

        Args:
            before: (M,) range.
        Returns: (S,) rows, k, g, and which of these samples are the neighbours before and after each on its ray, the
            sample itself where it has none.
        """
        rows, k, g = (torch.cat(parts) for parts in zip(*self._parts, strict=True))
        usable = torch.isfinite(g) & (k <= before[rows])
        rows, k, g = rows[usable], k[usable], g[usable]
        order = torch.argsort(k, stable=True)
        order = order[torch.argsort(rows[order], stable=True)]
        rows, k, g = rows[order], k[order], g[order]
        same = torch.zeros(len(rows) + 1, dtype=torch.bool)
        same[1:-1] = rows[1:] == rows[:-1]
        at = torch.arange(len(rows))
        return rows, k, g, at - same[:-1].long(), at + same[1:].long()

    def shelves(self, crossing: Tensor, found: Tensor, apart_m: float) -> tuple[Tensor, Tensor]:
        """The lowest sample on a shelf of each of M rays, at least `apart_m` before its crossing: g and range.

        A shelf in front of a hit is where a surface may rise that hides it.

        Args:
            crossing: (M,) range of the crossing. found: (M,) which rays have one.
        Returns: (M,) g, infinite where there is no such sample, and (M,) ranges.
        """
        lowest, where = torch.full_like(crossing, torch.inf), crossing.clone()
        if not self._parts:
            return lowest, where
        rows, k, g = (torch.cat(parts) for parts in zip(*self._parts, strict=True))
        left = crossing[rows] - k
        on_shelf = found[rows] & (left >= apart_m) & (g >= 0) & (g < SLACK * left)
        rows, k, g = rows[on_shelf], k[on_shelf], g[on_shelf]
        order = torch.argsort(g, stable=True)
        order = order[torch.argsort(rows[order], stable=True)]
        rows, k, g = rows[order], k[order], g[order]
        first = torch.ones(len(rows), dtype=torch.bool)
        first[1:] = rows[1:] != rows[:-1]
        lowest[rows[first]], where[rows[first]] = g[first], k[first]
        return lowest, where
