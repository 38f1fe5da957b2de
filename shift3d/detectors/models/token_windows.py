"""Grouping of the tokens of a sparse bird's-eye map by square windows, for attention within each window.

The window lattice is fixed to the full grid, so that a token's window depends neither on the computed part of the scene
nor on the order of the points. Windows are padded to one of a few lengths; the longest length is the window's area, so
that no token is dropped. Source: SST (Fan et al. 2022), section 3.3 (regional grouping and region shift).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Tokens:
    """Positions of P tokens: batch, cell_x, cell_y, (P,) int64 each; cells of the full grid."""

    batch: Ints
    cell_x: Ints
    cell_y: Ints

    def take(self, rows: npt.NDArray[np.bool_]) -> Tokens:
        """Return the tokens of a mask (P,), in their order."""
        return Tokens(self.batch[rows], self.cell_x[rows], self.cell_y[rows])


@dataclass(frozen=True)
class Bucket:
    """Windows padded to one length: windows * length slots, after the slots of the previous bucket.

    padding: (windows, 1, 1, length) bool, True for tokens and False for padding; None if every slot holds a token.
    """

    windows: int
    length: int
    padding: Tensor | None


@dataclass(frozen=True)
class WindowGroups:
    """Buckets of windows, and the maps between their slots and tokens.

    slot_token: (S,) int64, token in each slot, P (one past the last) for padding. token_slot: (P,) int64, slot of each
    token. place: (P,) int64, y * window + x of a token within its window.
    """

    buckets: tuple[Bucket, ...]
    slot_token: Tensor
    token_slot: Tensor
    place: Tensor

    def to(self, device: torch.device) -> WindowGroups:
        buckets = tuple(
            Bucket(b.windows, b.length, None if b.padding is None else b.padding.to(device)) for b in self.buckets
        )
        return WindowGroups(buckets, self.slot_token.to(device), self.token_slot.to(device), self.place.to(device))


def group_by_window(tokens: Tokens, window: int, shift: int, lengths: tuple[int, ...]) -> WindowGroups:
    """Group tokens by windows of window x window cells, with the lattice shifted back by `shift` cells.

    lengths: padded lengths, ascending; the window's area is appended if all are smaller. Windows are ordered by
    (length, batch, y, x), tokens within a window by their place.
    """
    column, line = tokens.cell_x + shift, tokens.cell_y + shift
    place = line % window * window + column % window
    # Window key that increases with (batch, y, x); cells are below 2**15.
    owner = ((tokens.batch << 32) | (line // window << 16)) | column // window
    order = np.lexsort((place, owner))
    starts = np.flatnonzero(np.diff(owner[order], prepend=-1))
    counts = np.diff(starts, append=order.size)
    padded = np.asarray(sorted({*(length for length in lengths if length < window**2), window**2}), dtype=np.int64)
    length_of = padded[np.searchsorted(padded, counts)]
    slot_token = np.empty(0, dtype=np.int64)
    buckets = []
    for length in padded.tolist():
        chosen = np.flatnonzero(length_of == length)
        if not chosen.size:
            continue
        column_of = np.arange(length)
        filled = column_of[None] < counts[chosen, None]
        rows = np.where(filled, starts[chosen, None] + column_of[None], 0)
        tokens_of = np.where(filled, order[rows], order.size)
        mask = None if filled.all() else torch.from_numpy(filled).view(chosen.size, 1, 1, length)
        buckets.append(Bucket(chosen.size, length, mask))
        slot_token = np.concatenate((slot_token, tokens_of.reshape(-1)))
    token_slot = np.empty(order.size, dtype=np.int64)
    is_token = slot_token < order.size
    token_slot[slot_token[is_token]] = np.flatnonzero(is_token)
    return WindowGroups(
        tuple(buckets), torch.from_numpy(slot_token), torch.from_numpy(token_slot), torch.from_numpy(place)
    )


def aligned_span(low: int, high: int, window: int, shift: int) -> tuple[int, int]:
    """Extend cells [low, high) along one axis to whole windows."""
    return (low + shift) // window * window - shift, -(-(high + shift) // window) * window - shift


class _GatherRows(torch.autograd.Function):
    """Row gather whose backward pass is a gather too, because the inverse of the index is known."""

    @staticmethod
    def forward(ctx, rows: Tensor, index: Tensor, inverse: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
        ctx.save_for_backward(index, inverse)
        return _take(rows, index)

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None, None]:  # type: ignore[no-untyped-def]
        index, inverse = ctx.saved_tensors
        return gather_rows(grad, inverse, index), None, None


def _take(rows: Tensor, index: Tensor) -> Tensor:
    """Gather rows (N, C) by index (M,) in 0..N; index N gives a row of zeros."""
    if not len(rows):
        return rows.new_zeros(len(index), rows.shape[1])
    taken = rows.index_select(0, index.clamp_max(len(rows) - 1))
    return taken.index_fill_(0, torch.nonzero(index == len(rows)).squeeze(1), 0.0)


def gather_rows(rows: Tensor, index: Tensor, inverse: Tensor) -> Tensor:
    """Gather rows (N, C) by index (M,) to (M, C); index N gives zeros. Differentiable w.r.t. rows.

    inverse: (N,) in 0..M, position of each row in index, M for an unused row. Each row is used at most once, so that
    the gradient is a gather too: faster than a scatter-add, and equal bit for bit.
    """
    result: Tensor = _GatherRows.apply(rows, index, inverse)  # type: ignore[no-untyped-call]
    return result
