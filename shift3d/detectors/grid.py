"""Bird's-eye grid of PointPillars, and assignment of points to pillars.

Voxelisation is dynamic: a pillar keeps all its points, without a limit. The order of the input points therefore does
not matter, and no point loses its gradient. Points are sorted by (pillar, x, y, z), so every later reduction is the
same bit for bit for any input order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow


@dataclass(frozen=True)
class Grid:
    """Grid of square cells on the ground; metres, network frame. Bounds are half-open: [min, max)."""

    x_min_m: float = -74.88
    y_min_m: float = -74.88
    z_min_m: float = -2.0
    z_max_m: float = 4.0
    cell_m: float = 0.32
    num_x: int = 468
    num_y: int = 468


WAYMO_GRID = Grid()
"""x, y within 74.88 m, z -2..4 m, pillars of 0.32 m. Source: public Waymo config that SHIFT3D follows."""


@dataclass(frozen=True)
class Pillars:
    """Points grouped by pillar.

    order: (K,) int64, input rows of the points inside the window, sorted by (pillar, x, y, z).
    pillar: (K,) int64, pillar index 0..P-1 of each sorted point.
    counts: (P,) int64, number of points per pillar. cell_x, cell_y: (P,) int64, cell of the pillar in the full grid.
    """

    order: Tensor
    pillar: Tensor
    counts: Tensor
    cell_x: Tensor
    cell_y: Tensor


def full_window(grid: Grid) -> BevWindow:
    return BevWindow(0, 0, grid.num_x, grid.num_y, 0, 0, grid.num_x, grid.num_y)


def core_cells(window: BevWindow) -> tuple[Tensor, Tensor]:
    """Return the rows (h,) and columns (w,) of the window's core in the full grid, int64."""
    lines = torch.arange(window.core_y0, window.core_y0 + window.core_num_y)
    return lines, torch.arange(window.core_x0, window.core_x0 + window.core_num_x)


def cells_of(
    points: Tensor, grid: Grid, window: BevWindow
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Compute the column and row (N,) of each point's cell in the full grid, and a mask (N,) of the valid points.

    points: (N, 3) float, network frame. A point is invalid if it is outside the window or the height range, or not
    finite. Cells are whole numbers, computed in float64: they do not depend on the precision of the points.
    """
    x, y, z = points.detach().to("cpu", torch.float64).numpy().T
    with np.errstate(invalid="ignore", over="ignore"):
        cell_x = np.floor((x - grid.x_min_m) / grid.cell_m)
        cell_y = np.floor((y - grid.y_min_m) / grid.cell_m)
        inside = (
            (cell_x >= window.x0) & (cell_x < window.x0 + window.num_x)
            & (cell_y >= window.y0) & (cell_y < window.y0 + window.num_y)
            & (z >= grid.z_min_m) & (z < grid.z_max_m)
        )  # fmt: skip
    return cell_x, cell_y, inside


def concatenate_pillars(parts: Sequence[Pillars], sizes: Sequence[int]) -> Pillars:
    """Merge the pillars of several point clouds into the pillars of the concatenated cloud.

    sizes: number of points of each cloud. Several pillars, one of each cloud, may have the same cell.
    """
    if len(parts) == 1:
        return parts[0]
    pillars_before = accumulate((part.counts.numel() for part in parts), initial=0)
    return Pillars(
        order=torch.cat(
            [part.order + before for part, before in zip(parts, accumulate(sizes, initial=0), strict=False)]
        ),
        pillar=torch.cat([part.pillar + before for part, before in zip(parts, pillars_before, strict=False)]),
        counts=torch.cat([part.counts for part in parts]),
        cell_x=torch.cat([part.cell_x for part in parts]),
        cell_y=torch.cat([part.cell_y for part in parts]),
    )


def assign_pillars(points: Tensor, grid: Grid, window: BevWindow) -> Pillars:
    """Group points by pillar; leave out points outside the window or the height range, or not finite.

    points: (N, 3) float, network frame. Not differentiable: a point on the edge of a pillar changes its pillar with
    the floor function, whose gradient is zero.
    """
    cell_x, cell_y, inside = cells_of(points, grid, window)
    rows = np.nonzero(inside)[0]
    flat = cell_y[rows].astype(np.int64) * grid.num_x + cell_x[rows].astype(np.int64)
    x, y, z = points.detach().to("cpu", torch.float64).numpy()[rows].T
    by_value = np.lexsort((z, y, x, flat))
    flat = flat[by_value]
    starts = np.flatnonzero(np.diff(flat, prepend=-1))
    counts = np.diff(starts, append=flat.size)
    cells = flat[starts]
    # Grouped on the CPU even if the points are on another device: sorting must give the same order on every device.
    return Pillars(
        order=torch.from_numpy(rows[by_value]).to(points.device),
        pillar=torch.from_numpy(np.repeat(np.arange(starts.size), counts)).to(points.device),
        counts=torch.from_numpy(counts).to(points.device),
        cell_x=torch.from_numpy(cells % grid.num_x).to(points.device),
        cell_y=torch.from_numpy(cells // grid.num_x).to(points.device),
    )
