"""Sets of active cells of a map, and their propagation through 3x3 convolutions (padding 1, any stride).

A set is a boolean mask (H + 2, W + 2): the map and a ring of one cell around it. The ring is the zero padding of the
convolution and never belongs to a set. The number of a cell is its index in the flattened mask.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, Pillars, cells_of

CellMask = npt.NDArray[np.bool_]
CellIndices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class MapShape:
    """Height and width of a map in cells, without the ring."""

    height: int
    width: int

    @property
    def rows(self) -> int:
        """Number of cells including the ring: the upper bound of cell numbers."""
        return (self.height + 2) * (self.width + 2)

    def strided(self, stride: int) -> MapShape:
        """Return the shape of this map after a 3x3 convolution with padding 1."""
        return MapShape((self.height - 1) // stride + 1, (self.width - 1) // stride + 1)

    def neighbours(self, cells: CellIndices, stride: int) -> CellIndices:
        """Return the cells (n, 9) of this map that cells (n,) of the strided map read, by row, then column."""
        offsets = (np.arange(3)[:, None] * (self.width + 2) + np.arange(3)).reshape(-1)
        return np.asarray(_first_read(self, stride)[cells][:, None] + offsets, dtype=np.int64)


@lru_cache(maxsize=64)
def _first_read(shape: MapShape, stride: int) -> CellIndices:
    """Compute the first cell of a map that each cell of the strided map reads; meaningless for cells of the ring."""
    strided = shape.strided(stride)
    y, x = np.arange(strided.height + 2) - 1, np.arange(strided.width + 2) - 1
    first = (y[:, None] * (shape.width + 2) + x).reshape(-1) * stride
    first.flags.writeable = False
    return first


def empty_mask(shape: MapShape) -> CellMask:
    """Return the empty set of cells."""
    return np.zeros((shape.height + 2, shape.width + 2), dtype=bool)


def full_mask(shape: MapShape) -> CellMask:
    """Return the set of all cells."""
    result = empty_mask(shape)
    result[1:-1, 1:-1] = True
    return result


def reached(cells: CellMask, stride: int) -> CellMask:
    """Return the cells of the strided map that read at least one of the given cells."""
    shape = MapShape(cells.shape[0] - 2, cells.shape[1] - 2).strided(stride)
    result = empty_mask(shape)
    spans = _taps(shape.height, stride)
    lines = cells[spans[0]] | cells[spans[1]] | cells[spans[2]]
    spans = _taps(shape.width, stride)
    result[1:-1, 1:-1] = lines[:, spans[0]] | lines[:, spans[1]] | lines[:, spans[2]]
    return result


def sources(cells: CellMask, stride: int, shape: MapShape) -> CellMask:
    """Return the cells of a map of shape `shape` that the given cells of the strided map read."""
    inner = cells[1:-1, 1:-1]
    lines = np.zeros((shape.height + 2, inner.shape[1]), dtype=bool)
    for span in _taps(inner.shape[0], stride):
        lines[span] |= inner
    result = empty_mask(shape)
    for span in _taps(inner.shape[1], stride):
        result[:, span] |= lines
    result[[0, -1]] = False
    result[:, [0, -1]] = False
    return result


def pooled(cells: CellMask, factor: int) -> CellMask:
    """Return the cells of the map coarser by `factor` (a divisor of both sides) that contain a given cell."""
    inner = cells[1:-1, 1:-1]
    result = empty_mask(MapShape(inner.shape[0] // factor, inner.shape[1] // factor))
    lines = np.logical_or.reduce([inner[first::factor] for first in range(factor)])
    np.logical_or.reduce([lines[:, first::factor] for first in range(factor)], out=result[1:-1, 1:-1])
    return result


def fine_cells(coarse: CellIndices, factor: int, fine: MapShape) -> CellIndices:
    """Return the cells (n, factor²) of the map `fine` inside the cells (n,) of the map coarser by `factor`."""
    y, x = np.divmod(coarse, fine.width // factor + 2)
    first = ((y - 1) * factor + 1) * (fine.width + 2) + (x - 1) * factor + 1
    offsets = (np.arange(factor)[:, None] * (fine.width + 2) + np.arange(factor)).reshape(-1)
    return np.asarray(first[:, None] + offsets, dtype=np.int64)


def _taps(outputs: int, stride: int) -> tuple[slice, slice, slice]:
    """Return for each of the three kernel taps on an axis the slice of input cells (ring included) that it reads."""
    last = stride * (outputs - 1) + 1
    return slice(0, last, stride), slice(1, last + 1, stride), slice(2, last + 2, stride)


class PointCells:
    """Points of the current frame and their cells in the cached window.

    A point without a cell (outside the window or not finite) has cell number 0, which is in the ring, so in no set.
    """

    def __init__(self, grid: Grid, window: BevWindow, dtype: torch.dtype) -> None:
        self.grid, self.window = grid, window
        self.shape = MapShape(window.num_y, window.num_x)
        self.cell_of_point: CellIndices = np.empty(0, dtype=np.int64)
        self._points = torch.empty(0, 3, dtype=dtype)

    def changed(self, points: Tensor) -> CellMask:
        """Store points (N, 3) of the next frame. Return the cells that a moved point left or entered."""
        changed = empty_mask(self.shape)
        flat = changed.reshape(-1)
        if points.shape != self._points.shape:
            flat[self.cell_of_point] = True
            self.cell_of_point = self._cells_of(points)
            flat[self.cell_of_point] = True
        else:
            rows = np.flatnonzero((points != self._points).numpy()) // 3  # may have duplicates
            flat[self.cell_of_point[rows]] = True
            self.cell_of_point[rows] = self._cells_of(points[torch.from_numpy(rows)])
            flat[self.cell_of_point[rows]] = True
        flat[0] = False
        self._points = points.clone()
        return changed

    def _cells_of(self, points: Tensor) -> CellIndices:
        x, y, inside = cells_of(points, self.grid, self.window)
        numbers = (y - (self.window.y0 - 1)) * (self.shape.width + 2) + x - (self.window.x0 - 1)
        return np.where(inside, numbers, 0.0).astype(np.int64)

    def cells(self, chosen: Tensor | None = None) -> CellMask:
        """Return the cells that contain a point, or a point of the mask `chosen` (N,) bool."""
        cells = empty_mask(self.shape)
        cells.reshape(-1)[self.cell_of_point if chosen is None else self.cell_of_point[chosen.numpy()]] = True
        cells[0, 0] = False
        return cells

    def rows(self, among: CellMask) -> Tensor:
        """Return the indices of the points in the given cells, int64."""
        return torch.from_numpy(np.flatnonzero(among.reshape(-1)[self.cell_of_point]))

    def indices(self, pillars: Pillars) -> CellIndices:
        """Return the cell numbers (P,) of pillars of this window."""
        lines, columns = pillars.cell_y - (self.window.y0 - 1), pillars.cell_x - (self.window.x0 - 1)
        return np.asarray((lines * (self.shape.width + 2) + columns).numpy(), dtype=np.int64)
