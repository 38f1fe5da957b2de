"""Anchor boxes: one size, two headings, in every cell of the grid."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid


@dataclass(frozen=True)
class AnchorSpec:
    """Size and headings of the anchors, standing on the ground; metres and radians."""

    size_m: tuple[float, float, float] = (4.73, 2.08, 1.77)
    headings_rad: tuple[float, ...] = (0.0, pi / 2)


WAYMO_ANCHORS = AnchorSpec()


def anchor_boxes(spec: AnchorSpec, grid: Grid, window: BevWindow) -> Tensor:
    """Anchors of the window's core: (A, 7) float32, network frame, A over y, then x, then heading.

    Source: public Waymo config of PointPillars (bottom of the anchor at the ground).
    """
    length, width, height = spec.size_m
    columns = torch.arange(window.core_x0, window.core_x0 + window.core_num_x, dtype=torch.float64)
    lines = torch.arange(window.core_y0, window.core_y0 + window.core_num_y, dtype=torch.float64)
    x = grid.x_min_m + (columns + 0.5) * grid.cell_m
    y = grid.y_min_m + (lines + 0.5) * grid.cell_m
    headings = torch.tensor(spec.headings_rad, dtype=torch.float64)
    y_all, x_all, heading_all = torch.meshgrid(y, x, headings, indexing="ij")
    z, dx, dy, dz = (torch.full_like(x_all, value) for value in (height / 2, length, width, height))
    return torch.stack((x_all, y_all, z, dx, dy, dz, heading_all), dim=-1).reshape(-1, 7).to(torch.float32)
