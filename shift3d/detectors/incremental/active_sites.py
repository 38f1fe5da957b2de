"""Sets of cells of a map, and how a 3x3 convolution (padding 1, any stride) carries them from map to map.

A set is a boolean mask (H + 2, W + 2): the map with a ring of one cell around it, which is the convolution's zero
padding and never belongs to a set. A cell's number is its place in the flattened mask.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

ActiveSites = npt.NDArray[np.bool_]
SiteIndices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class MapShape:
    """Height and width of a map in cells, without the ring."""

    height: int
    width: int

    @property
    def rows(self) -> int:
        """Cells with the ring: what a cell's number is below."""
        return (self.height + 2) * (self.width + 2)

    def strided(self, stride: int) -> MapShape:
        """The map that a 3x3 convolution with padding 1 makes of this one."""
        return MapShape((self.height - 1) // stride + 1, (self.width - 1) // stride + 1)

    def neighbours(self, cells: SiteIndices, stride: int) -> SiteIndices:
        """(n, 9): the cells of this map that the given cells (n,) of the strided map read, by row, then column."""
        offsets = (np.arange(3)[:, None] * (self.width + 2) + np.arange(3)).reshape(-1)
        return np.asarray(_first_read(self, stride)[cells][:, None] + offsets, dtype=np.int64)


@lru_cache(maxsize=64)
def _first_read(shape: MapShape, stride: int) -> SiteIndices:
    """The first cell of a map that each cell of the strided map reads; meaningless for the ring."""
    strided = shape.strided(stride)
    y, x = np.arange(strided.height + 2) - 1, np.arange(strided.width + 2) - 1
    first = (y[:, None] * (shape.width + 2) + x).reshape(-1) * stride
    first.flags.writeable = False
    return first


def empty_set(shape: MapShape) -> ActiveSites:
    """No cell of a map."""
    return np.zeros((shape.height + 2, shape.width + 2), dtype=bool)


def whole_set(shape: MapShape) -> ActiveSites:
    """Every cell of a map."""
    result = empty_set(shape)
    result[1:-1, 1:-1] = True
    return result


def reached(cells: ActiveSites, stride: int) -> ActiveSites:
    """The cells of the strided map that read one of these."""
    shape = MapShape(cells.shape[0] - 2, cells.shape[1] - 2).strided(stride)
    result = empty_set(shape)
    spans = _taps(shape.height, stride)
    lines = cells[spans[0]] | cells[spans[1]] | cells[spans[2]]
    spans = _taps(shape.width, stride)
    result[1:-1, 1:-1] = lines[:, spans[0]] | lines[:, spans[1]] | lines[:, spans[2]]
    return result


def sources(cells: ActiveSites, stride: int, shape: MapShape) -> ActiveSites:
    """The cells of a map of this shape that the given cells of the strided map read."""
    inner = cells[1:-1, 1:-1]
    lines = np.zeros((shape.height + 2, inner.shape[1]), dtype=bool)
    for span in _taps(inner.shape[0], stride):
        lines[span] |= inner
    result = empty_set(shape)
    for span in _taps(inner.shape[1], stride):
        result[:, span] |= lines
    result[[0, -1]] = False
    result[:, [0, -1]] = False
    return result


def pooled(cells: ActiveSites, factor: int) -> ActiveSites:
    """The cells of a map coarser by `factor`, a divisor of its sides, that hold one of these."""
    inner = cells[1:-1, 1:-1]
    result = empty_set(MapShape(inner.shape[0] // factor, inner.shape[1] // factor))
    lines = np.logical_or.reduce([inner[first::factor] for first in range(factor)])
    np.logical_or.reduce([lines[:, first::factor] for first in range(factor)], out=result[1:-1, 1:-1])
    return result


def fine_cells(coarse: SiteIndices, factor: int, fine: MapShape) -> SiteIndices:
    """(n, factor²): the cells of the map `fine` inside the given cells (n,) of the map coarser by `factor`."""
    y, x = np.divmod(coarse, fine.width // factor + 2)
    first = ((y - 1) * factor + 1) * (fine.width + 2) + (x - 1) * factor + 1
    offsets = (np.arange(factor)[:, None] * (fine.width + 2) + np.arange(factor)).reshape(-1)
    return np.asarray(first[:, None] + offsets, dtype=np.int64)


def _taps(outputs: int, stride: int) -> tuple[slice, slice, slice]:
    """For each of the kernel's three places on an axis: the ringed input cells that the outputs read there."""
    last = stride * (outputs - 1) + 1
    return slice(0, last, stride), slice(1, last + 1, stride), slice(2, last + 2, stride)
