"""Incremental inference of SST across the frames of one scene.

Attention mixes the tokens of a window, and the windows of the next layer are shifted. Layer by layer a moved point
therefore changes more windows, while the proposals around the object need fewer windows. Each layer recomputes the
windows that changed and are needed; all other tokens come from earlier calls. Gradients follow the same rule: only
tokens that depend on a point with a gradient carry one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.incremental.active_sites import (
    CellIndices,
    CellMask,
    PointCells,
    empty_mask,
    full_mask,
)
from shift3d.detectors.incremental.inference import CachedInference, Plain
from shift3d.detectors.models.sst import SstNet
from shift3d.detectors.models.token_windows import Tokens


@dataclass(frozen=True)
class _LayerState:
    """State passed from layer to layer.

    new: cells whose tokens changed since the next layer last read them. with_grad: (n,) cells, ascending, of the tokens
    with a gradient; features: (n, width) of these tokens.
    """

    new: CellMask
    with_grad: CellIndices
    features: Tensor


class _WindowLattice:
    """Attention windows of one shift on a part of the grid."""

    def __init__(self, part: BevWindow, size: int, shift: int) -> None:
        self._lines = _owners(part.y0, part.num_y, size, shift)
        self._columns = _owners(part.x0, part.num_x, size, shift)

    def whole(self, cells: CellMask) -> CellMask:
        """Return all cells of the windows that contain one of the given cells."""
        held = cells[1:-1, 1:-1]
        for axis, owner in enumerate((self._lines, self._columns)):
            held = np.logical_or.reduceat(held, np.flatnonzero(np.diff(owner, prepend=-1)), axis)
        result = np.zeros_like(cells)
        result[1:-1, 1:-1] = held[self._lines][:, self._columns]
        return result


def _owners(first: int, count: int, size: int, shift: int) -> CellIndices:
    """Compute the window index (count,) of each cell along an axis, starting at 0."""
    owner = (first + np.arange(count) + shift) // size
    return np.asarray(owner - owner[0], dtype=np.int64)


class IncrementalTokens(CachedInference):
    """Incremental inference of SST.

    net: for inference. exact: dtype of points and tokens. answer: (features of the core, its window) -> proposals.
    """

    def __init__(self, net: SstNet, window: BevWindow, exact: torch.dtype, plain: Plain, answer: Plain) -> None:
        super().__init__(window, exact, plain, net, answer)
        self._net, self._answer = net, answer
        self._points = PointCells(net.grid, window, exact)
        transformer = net.spec.transformer
        self._lattices = [_WindowLattice(window, transformer.window, shift) for shift in transformer.shifts]
        # For the encoder and every layer: cells that changed since they were last computed; initially all cells.
        self._stale = [full_mask(self._points.shape) for _ in range(len(self._lattices) + 1)]
        # Tokens of the encoder and of every layer. A cell keeps its row once it has held a point.
        self._row_of_cell: CellIndices = np.full(self._points.shape.rows, -1, dtype=np.int64)
        self._tables = [torch.zeros(0, transformer.width, dtype=exact) for _ in self._stale]
        self._rows_taken = 0

    def _cached(self, points: Tensor, window: BevWindow, requires_grad: Tensor | None) -> Proposals:
        needed = self._needed(window)
        changed = self._points.changed(points.detach())
        held = self._points.cells()
        self._take_rows(np.flatnonzero(held))
        tracked = torch.is_grad_enabled() and points.requires_grad
        grad_cells = self._points.cells(requires_grad) if tracked else empty_mask(self._points.shape)
        flow = self._encode(points, changed, grad_cells & needed[0], needed[0])
        for index in range(len(self._lattices)):
            flow = self._attend(index, flow, needed[index + 1], held)
        cells = np.flatnonzero(needed[-1] & held)
        features = self._read(-1, cells, flow)
        return self._answer(self._net.core_features(features, self._tokens(cells), [window]), window)

    def _needed(self, window: BevWindow) -> list[CellMask]:
        """Return the cells that the window's core depends on: of the encoder, then of every layer."""
        columns, lines = (
            [*self._net.transformer.needed_spans(low, high), (low, high)] for low, high in self._net.core_spans(window)
        )
        result = []
        for (x_low, x_high), (y_low, y_high) in zip(columns, lines, strict=True):
            cells = empty_mask(self._points.shape)
            inner, first_x, first_y = cells[1:-1, 1:-1], self._window.x0, self._window.y0
            inner[max(0, y_low - first_y) : y_high - first_y, max(0, x_low - first_x) : x_high - first_x] = True
            result.append(cells)
        return result

    def _take_rows(self, cells: CellIndices) -> None:
        """Assign a row of the tables to each of these cells that has none."""
        new = cells[self._row_of_cell[cells] < 0]
        self._row_of_cell[new] = self._rows_taken + np.arange(len(new))
        self._rows_taken += len(new)
        if self._rows_taken > len(self._tables[0]):
            more = self._rows_taken * 5 // 4 - len(self._tables[0])  # moving shadows uncover cells at every call
            self._tables = [torch.cat((table, table.new_zeros(more, table.shape[1]))) for table in self._tables]

    def _rows(self, cells: CellIndices) -> Tensor:
        return torch.from_numpy(self._row_of_cell[cells])

    def _tokens(self, cells: CellIndices) -> Tokens:
        line, column = np.divmod(cells, self._points.shape.width + 2)
        return Tokens(np.zeros_like(cells), column + self._window.x0 - 1, line + self._window.y0 - 1)

    def _read(self, level: int, cells: CellIndices, flow: _LayerState) -> Tensor:
        """Return the tokens (n, width) of cells (n,), ascending; tokens with a gradient stay attached to the graph."""
        features = self._tables[level].index_select(0, self._rows(cells))
        among = np.isin(flow.with_grad, cells, assume_unique=True)
        if not among.any():
            return features
        places = torch.from_numpy(np.searchsorted(cells, flow.with_grad[among]))
        return features.index_copy(0, places, flow.features[torch.from_numpy(among)])

    def _write(self, level: int, cells: CellIndices, features: Tensor) -> None:
        self._tables[level].index_copy_(0, self._rows(cells), features.detach())

    def _encode(self, points: Tensor, changed: CellMask, with_grad: CellMask, needed: CellMask) -> _LayerState:
        """Encode the pillars that changed and are needed, and with a gradient those in `with_grad`."""
        changed = changed | self._stale[0]
        due, self._stale[0] = changed & needed, changed & ~needed
        with torch.no_grad():
            self._write(0, *self._pillars(points.detach(), due & ~with_grad))
        cells, features = self._pillars(points, with_grad)
        self._write(0, cells, features)
        return _LayerState(due, cells, features)

    def _pillars(self, points: Tensor, among: CellMask) -> tuple[CellIndices, Tensor]:
        """Return the cells of `among` that contain a point, ascending, and their features."""
        pillars, features = self._net.pillar_features(points.index_select(0, self._points.rows(among)), self._window)
        return self._points.indices(pillars), features

    def _attend(self, index: int, flow: _LayerState, needed: CellMask, held: CellMask) -> _LayerState:
        """Compute a layer in the needed windows that have a changed token or a token with a gradient.

        All tokens of a needed window are in the tables, because the previous layer needed them too.
        """
        lattice, level = self._lattices[index], index + 1
        with_grad = empty_mask(self._points.shape)
        with_grad.reshape(-1)[flow.with_grad] = True
        changed = lattice.whole(flow.new) | self._stale[level]
        grad_windows = lattice.whole(lattice.whole(with_grad) & needed)
        due_windows = lattice.whole(changed & needed) & ~grad_windows
        self._stale[level] = changed & ~(due_windows | grad_windows)
        with torch.no_grad():
            cells = np.flatnonzero(due_windows & held)
            self._write(level, cells, self._layer(index, cells, self._read(index, cells, flow)))
        cells = np.flatnonzero(grad_windows & held)
        features = self._layer(index, cells, self._read(index, cells, flow))
        self._write(level, cells, features)
        return _LayerState(changed & (due_windows | grad_windows), cells, features)

    def _layer(self, index: int, cells: CellIndices, features: Tensor) -> Tensor:
        return self._net.transformer.layer(index, features, self._tokens(cells)) if len(cells) else features
