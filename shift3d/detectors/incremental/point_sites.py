"""The points of a scene from frame to frame: which cells of a window held or hold one that is not where it was."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, Pillars, cells_of
from shift3d.detectors.incremental.active_sites import ActiveSites, MapShape, SiteIndices, empty_set


def contains(outer: BevWindow, inner: BevWindow) -> bool:
    """Whether one window lies in another."""
    return (
        outer.x0 <= inner.x0
        and outer.y0 <= inner.y0
        and inner.x0 + inner.num_x <= outer.x0 + outer.num_x
        and inner.y0 + inner.num_y <= outer.y0 + outer.num_y
    )


class PointSites:
    """One frame's points and the cells of the cached window that they lie in.

    Cells are numbered as in `cell_sets`: lines first, with a ring of one cell around the window. A point that has no
    cell (outside, not finite) is given number 0, which belongs to the ring and never to a set.
    """

    def __init__(self, grid: Grid, window: BevWindow, dtype: torch.dtype) -> None:
        self.grid, self.window = grid, window
        self.shape = MapShape(window.num_y, window.num_x)
        self.cell_of_point: SiteIndices = np.empty(0, dtype=np.int64)
        self._points = torch.empty(0, 3, dtype=dtype)

    def changed(self, points: Tensor) -> ActiveSites:
        """Take points (N, 3) for the next frame: the cells that held or hold a point that is not where it was."""
        changed = empty_set(self.shape)
        flat = changed.reshape(-1)
        if points.shape != self._points.shape:
            flat[self.cell_of_point] = True
            self.cell_of_point = self._cells_of(points)
            flat[self.cell_of_point] = True
        else:
            rows = np.flatnonzero((points != self._points).numpy()) // 3  # some of them more than once
            flat[self.cell_of_point[rows]] = True
            self.cell_of_point[rows] = self._cells_of(points[torch.from_numpy(rows)])
            flat[self.cell_of_point[rows]] = True
        flat[0] = False
        self._points = points.clone()
        return changed

    def _cells_of(self, points: Tensor) -> SiteIndices:
        x, y, inside = cells_of(points, self.grid, self.window)
        numbers = (y - (self.window.y0 - 1)) * (self.shape.width + 2) + x - (self.window.x0 - 1)
        return np.where(inside, numbers, 0.0).astype(np.int64)

    def cells(self, chosen: Tensor | None = None) -> ActiveSites:
        """The cells that hold a point; chosen: (N,) bool, one of these points."""
        cells = empty_set(self.shape)
        cells.reshape(-1)[self.cell_of_point if chosen is None else self.cell_of_point[chosen.numpy()]] = True
        cells[0, 0] = False
        return cells

    def rows(self, among: ActiveSites) -> Tensor:
        """The points in these cells, int64."""
        return torch.from_numpy(np.flatnonzero(among.reshape(-1)[self.cell_of_point]))

    def indices(self, pillars: Pillars) -> SiteIndices:
        """(P,) the cells of pillars of this window."""
        lines, columns = pillars.cell_y - (self.window.y0 - 1), pillars.cell_x - (self.window.x0 - 1)
        return np.asarray((lines * (self.shape.width + 2) + columns).numpy(), dtype=np.int64)
