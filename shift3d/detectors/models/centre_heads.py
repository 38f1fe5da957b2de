"""Centre heads, without anchors: each cell predicts a logit for a vehicle centre in the cell, and a box."""

from __future__ import annotations

from math import log

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, core_cells
from shift3d.detectors.models.network import BoxHeads

CENTRE_CODES = 8
"""Offset from the cell's centre in x, y (cells), z (metres), log of three sizes (metres), sine, cosine of heading."""
MAX_LOG_SIZE = 5.0
TYPICAL_SIZE_M = (4.4, 1.8, 1.55)


def _centres(grid: Grid, cells: Tensor) -> Tensor:
    """Compute the centres (n, 2), metres, of cells (n, 2) given by column and row."""
    origin = torch.tensor((grid.x_min_m, grid.y_min_m), dtype=torch.float64)
    return origin + (cells.double() + 0.5) * grid.cell_m


def encode_centres(boxes: Tensor, cells: Tensor, grid: Grid) -> Tensor:
    """Encode boxes (n, 7) relative to the cells (n, 2), column and row, that predict them as codes (n, 8)."""
    offset = (boxes[:, :2] - _centres(grid, cells).to(boxes.dtype)) / grid.cell_m
    turn = torch.stack((torch.sin(boxes[:, 6]), torch.cos(boxes[:, 6])), dim=1)
    return torch.cat((offset, boxes[:, 2:3], torch.log(boxes[:, 3:6]), turn), dim=1)


def decode_centres(codes: Tensor, cells: Tensor, grid: Grid) -> Tensor:
    """Decode codes (n, 8) and their cells (n, 2) to boxes (n, 7), heading in (-pi, pi].

    Logarithms of sizes are clipped at +-5, so that no code can give an infinite box.
    Source: CenterPoint (Yin et al. 2021), section 4.1.
    """
    xy = _centres(grid, cells).to(codes.dtype) + codes[:, :2] * grid.cell_m
    sizes = torch.exp(codes[:, 3:6].clamp(-MAX_LOG_SIZE, MAX_LOG_SIZE))
    heading = torch.atan2(codes[:, 6:7], codes[:, 7:8])
    return torch.cat((xy, codes[:, 2:3], sizes, heading), dim=1)


class CentreHeads(BoxHeads):
    """1x1 convolutions for the heat map and the box of every cell."""

    per_cell = 1

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.classes = nn.Conv2d(channels, 1, 1)
        self.boxes = nn.Conv2d(channels, CENTRE_CODES, 1)
        # Initial score 0.01 in an empty scene. Source: focal loss (Lin et al. 2017), section 4.1.
        nn.init.constant_(self.classes.bias, -4.595)  # type: ignore[arg-type]
        nn.init.normal_(self.boxes.weight, std=0.001)
        start = (0.0, 0.0, TYPICAL_SIZE_M[2] / 2, *(log(size) for size in TYPICAL_SIZE_M), 0.0, 0.0)
        with torch.no_grad():
            self.boxes.bias.copy_(torch.tensor(start))  # type: ignore[union-attr]

    @property
    def box_layers(self) -> tuple[nn.Conv2d, ...]:
        return (self.boxes,)

    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        lines, columns = core_cells(window)
        y, x = torch.meshgrid(lines, columns, indexing="ij")
        return decode_centres(rows, torch.stack((x.reshape(-1), y.reshape(-1)), dim=1), grid)

    def reported(self, logits: Tensor, window: BevWindow) -> Tensor:
        """Return the mask of cells with the highest logit of their 3x3 neighbourhood in the core; ties all count.

        Source: CenterPoint, which uses the peaks of its heat map instead of suppression between anchors.
        """
        heat = logits.view(1, 1, window.core_num_y, window.core_num_x)
        return (heat == functional.max_pool2d(heat, 3, stride=1, padding=1)).reshape(-1)
