"""The bird's-eye grid of PointPillars, and which pillar each point falls into.

Voxelisation is dynamic: a pillar keeps every point, and there is no limit on their number, so the order of
the points cannot matter and no point loses its gradient. Points are sorted by (pillar, x, y, z), which makes
every later reduction the same to the bit however the input was ordered.
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
    """A square-celled grid over the ground; metres, network frame. Bounds are half-open: [min, max)."""

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

    order: (K,) int64, rows of the input that lie inside, sorted by (pillar, x, y, z).
    pillar: (K,) int64, for each sorted point the index of its pillar in 0..P-1.
    counts: (P,) int64, points in each pillar. cell_x, cell_y: (P,) int64, the pillar's cell in the full grid.
    """

    order: Tensor
    pillar: Tensor
    counts: Tensor
    cell_x: Tensor
    cell_y: Tensor


def full_window(grid: Grid) -> BevWindow:
    return BevWindow(0, 0, grid.num_x, grid.num_y, 0, 0, grid.num_x, grid.num_y)


def core_cells(window: BevWindow) -> tuple[Tensor, Tensor]:
    """(h,) lines and (w,) columns of the window's core, int64, in the full grid."""
    lines = torch.arange(window.core_y0, window.core_y0 + window.core_num_y)
    return lines, torch.arange(window.core_x0, window.core_x0 + window.core_num_x)


def cells_of(
    points: Tensor, grid: Grid, window: BevWindow
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """(N,) column and line of every point's cell in the full grid, whole numbers, and whether the point counts.

    points: (N, 3) float, network frame. A point that is outside the window or the height range or is not finite
    does not count. The same cells whatever the precision: computed in float64.
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


def side_by_side(parts: Sequence[Pillars], sizes: Sequence[int]) -> Pillars:
    """The pillars of several clouds as those of one cloud, which holds them one after the other.

    sizes: points of each cloud. Cells may then stand for several pillars, one of each cloud.
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
    """Group points by pillar; points outside the window, the height range or not finite are left out.

    points: (N, 3) float, network frame. Nothing here is differentiable: a point on a pillar's edge flips with
    the floor, and the gradient of that flip is zero.
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
    # Grouped on the CPU wherever the points are: sorting must give the same order on every device.
    return Pillars(
        order=torch.from_numpy(rows[by_value]).to(points.device),
        pillar=torch.from_numpy(np.repeat(np.arange(starts.size), counts)).to(points.device),
        counts=torch.from_numpy(counts).to(points.device),
        cell_x=torch.from_numpy(cells % grid.num_x).to(points.device),
        cell_y=torch.from_numpy(cells // grid.num_x).to(points.device),
    )
