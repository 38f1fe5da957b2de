"""Anchor heads: class, box code and direction of each anchor.

Box codes are relative to anchors as in SECOND (Yan et al. 2018, section 3.3), with direction bins. All boxes are
(x, y, z, dx, dy, dz, heading) with the geometric centre, metres, radians.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, core_cells
from shift3d.detectors.models.network import BoxHeads

DIRECTION_OFFSET_RAD = pi / 4
"""Bin 0 is heading in [pi/4, 5 pi/4), so that no bin ends at an anchor's heading. Source: SECOND's public config."""
MAX_LOG_RATIO = 5.0


def encode_boxes(boxes: Tensor, anchors: Tensor) -> Tensor:
    """Encode boxes (A, 7) relative to anchors (A, 7) as codes (A, 7); the code of the heading is the difference."""
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4])
    offset_xy = (boxes[:, :2] - anchors[:, :2]) / diagonal.unsqueeze(1)
    offset_z = (boxes[:, 2:3] - anchors[:, 2:3]) / anchors[:, 5:6]
    sizes = torch.log(boxes[:, 3:6] / anchors[:, 3:6])
    return torch.cat((offset_xy, offset_z, sizes, boxes[:, 6:7] - anchors[:, 6:7]), dim=1)


def direction_bins(heading_rad: Tensor) -> Tensor:
    """Return the direction bin of headings: 0 for [pi/4, 5 pi/4) modulo 2 pi, else 1. int64, any shape."""
    turned = torch.remainder(heading_rad - DIRECTION_OFFSET_RAD, 2 * pi)
    return (turned >= pi).to(torch.int64)


def decode_boxes(
    codes: Tensor, anchors: Tensor, direction_logits: Tensor, offset_rad: float = DIRECTION_OFFSET_RAD
) -> Tensor:
    """Decode codes (A, 7), anchors (A, 7) and direction logits (A, 2) to boxes (A, 7), heading in [-pi, pi).

    The sine loss leaves the heading ambiguous by half turns; the direction bin resolves it, bin 0 starts at offset_rad.
    Size codes are clipped at +-5, so that no code can give an infinite box.
    """
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4])
    centre_xy = codes[:, :2] * diagonal.unsqueeze(1) + anchors[:, :2]
    centre_z = codes[:, 2:3] * anchors[:, 5:6] + anchors[:, 2:3]
    sizes = torch.exp(codes[:, 3:6].clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)) * anchors[:, 3:6]
    half_turn = torch.remainder(codes[:, 6] + anchors[:, 6] - offset_rad, pi)
    bins = direction_logits.argmax(dim=1).to(codes.dtype)
    heading = half_turn + offset_rad + pi * bins
    heading = torch.remainder(heading + pi, 2 * pi) - pi
    return torch.cat((centre_xy, centre_z, sizes, heading.unsqueeze(1)), dim=1)


@dataclass(frozen=True)
class AnchorSpec:
    """Size and headings of the anchors, which are placed on the ground; metres and radians."""

    size_m: tuple[float, float, float] = (4.73, 2.08, 1.77)
    headings_rad: tuple[float, ...] = (0.0, pi / 2)


WAYMO_ANCHORS = AnchorSpec()


def anchor_boxes(spec: AnchorSpec, grid: Grid, window: BevWindow) -> Tensor:
    """Return the anchors of the window's core: (A, 7) float32, network frame, ordered by y, then x, then heading.

    window: in cells of the grid.
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
    """1x1 convolutions for class, box and direction of every anchor. Overlapping anchors compete in suppression."""

    direction_offset_rad = DIRECTION_OFFSET_RAD

    def __init__(self, channels: int, per_cell: int) -> None:
        super().__init__()
        self.per_cell = per_cell
        self.classes = nn.Conv2d(channels, per_cell, 1)
        self.boxes = nn.Conv2d(channels, per_cell * 7, 1)
        self.directions = nn.Conv2d(channels, per_cell * 2, 1)

    @abstractmethod
    def anchor_rows(self, grid: Grid, window: BevWindow) -> Tensor:
        """Return the anchors (A, 7) of the window's core, ordered by y, then x, then anchor of the cell."""

    @property
    def box_layers(self) -> tuple[nn.Conv2d, ...]:
        return self.boxes, self.directions

    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        codes = rows[:, : 7 * self.per_cell].reshape(-1, 7)
        directions = rows[:, 7 * self.per_cell :].reshape(-1, 2)
        return decode_boxes(codes, self.anchor_rows(grid, window).to(rows.dtype), directions, self.direction_offset_rad)


class AnchorHeads(AnchorConvolutions):
    """Heads with two anchors of one size per cell. The anchor size is part of the weights."""

    anchor_size_m: Tensor

    def __init__(self, channels: int, spec: AnchorSpec = WAYMO_ANCHORS) -> None:
        super().__init__(channels, len(spec.headings_rad))
        self.headings_rad = spec.headings_rad
        self.register_buffer("anchor_size_m", torch.tensor(spec.size_m))
        # Initial score 0.01 in an empty scene. Source: focal loss (Lin et al. 2017), section 4.1.
        nn.init.constant_(self.classes.bias, -4.595)  # type: ignore[arg-type]
        nn.init.normal_(self.boxes.weight, std=0.001)

    @property
    def anchors(self) -> AnchorSpec:
        length, width, height = (float(value) for value in self.anchor_size_m)
        return AnchorSpec((length, width, height), self.headings_rad)

    def anchor_rows(self, grid: Grid, window: BevWindow) -> Tensor:
        return anchor_boxes(self.anchors, grid, window)
