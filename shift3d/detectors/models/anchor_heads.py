"""Heads that predict against anchors: class, box code and direction of each."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, core_cells
from shift3d.detectors.models.box_coding import DIRECTION_OFFSET_RAD, decode_boxes
from shift3d.detectors.models.heads import BoxHeads


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
    lines, columns = core_cells(window)
    x = grid.x_min_m + (columns.double() + 0.5) * grid.cell_m
    y = grid.y_min_m + (lines.double() + 0.5) * grid.cell_m
    headings = torch.tensor(spec.headings_rad, dtype=torch.float64)
    y_all, x_all, heading_all = torch.meshgrid(y, x, headings, indexing="ij")
    z, dx, dy, dz = (torch.full_like(x_all, value) for value in (height / 2, length, width, height))
    return torch.stack((x_all, y_all, z, dx, dy, dz, heading_all), dim=-1).reshape(-1, 7).to(torch.float32)


class AnchorConvolutions(BoxHeads):
    """1x1 convolutions for class, box and direction of every anchor. Anchors of one object compete by their overlap."""

    direction_offset_rad = DIRECTION_OFFSET_RAD

    def __init__(self, channels: int, per_cell: int) -> None:
        super().__init__()
        self.per_cell = per_cell
        self.classes = nn.Conv2d(channels, per_cell, 1)
        self.boxes = nn.Conv2d(channels, per_cell * 7, 1)
        self.directions = nn.Conv2d(channels, per_cell * 2, 1)

    @abstractmethod
    def anchor_rows(self, grid: Grid, window: BevWindow) -> Tensor:
        """Anchors (A, 7) of the window's core, over y, then x, then the anchors of a cell."""

    @property
    def box_layers(self) -> tuple[nn.Conv2d, ...]:
        return self.boxes, self.directions

    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        codes = rows[:, : 7 * self.per_cell].reshape(-1, 7)
        directions = rows[:, 7 * self.per_cell :].reshape(-1, 2)
        return decode_boxes(codes, self.anchor_rows(grid, window).to(rows.dtype), directions, self.direction_offset_rad)


class AnchorHeads(AnchorConvolutions):
    """Two anchors a cell, one size. The anchors' size is part of the weights."""

    anchor_size_m: Tensor

    def __init__(self, channels: int, spec: AnchorSpec = WAYMO_ANCHORS) -> None:
        super().__init__(channels, len(spec.headings_rad))
        self.headings_rad = spec.headings_rad
        self.register_buffer("anchor_size_m", torch.tensor(spec.size_m))
        # An empty scene starts at a score of 0.01: Source: focal loss (Lin et al. 2017), section 4.1.
        nn.init.constant_(self.classes.bias, -4.595)  # type: ignore[arg-type]
        nn.init.normal_(self.boxes.weight, std=0.001)

    @property
    def anchors(self) -> AnchorSpec:
        """Size and headings of the anchors."""
        length, width, height = (float(value) for value in self.anchor_size_m)
        return AnchorSpec((length, width, height), self.headings_rad)

    def anchor_rows(self, grid: Grid, window: BevWindow) -> Tensor:
        return anchor_boxes(self.anchors, grid, window)
