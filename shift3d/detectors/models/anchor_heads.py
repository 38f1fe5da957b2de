"""Heads that predict against anchors: class, box code and direction of each."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.anchors import WAYMO_ANCHORS, AnchorSpec, anchor_boxes
from shift3d.detectors.models.box_coding import decode_boxes
from shift3d.detectors.models.heads import BoxHeads


class AnchorHeads(BoxHeads):
    """1x1 convolutions for class, box and direction. The anchors' size is part of the weights."""

    anchor_size_m: Tensor

    def __init__(self, channels: int, spec: AnchorSpec = WAYMO_ANCHORS) -> None:
        super().__init__()
        self.headings_rad = spec.headings_rad
        self.per_cell = len(spec.headings_rad)
        self.register_buffer("anchor_size_m", torch.tensor(spec.size_m))
        self.classes = nn.Conv2d(channels, self.per_cell, 1)
        self.boxes = nn.Conv2d(channels, self.per_cell * 7, 1)
        self.directions = nn.Conv2d(channels, self.per_cell * 2, 1)
        # An empty scene starts at a score of 0.01: Source: focal loss (Lin et al. 2017), section 4.1.
        nn.init.constant_(self.classes.bias, -4.595)  # type: ignore[arg-type]
        nn.init.normal_(self.boxes.weight, std=0.001)

    @property
    def anchors(self) -> AnchorSpec:
        """Size and headings of the anchors."""
        length, width, height = (float(value) for value in self.anchor_size_m)
        return AnchorSpec((length, width, height), self.headings_rad)

    @property
    def box_layers(self) -> tuple[nn.Conv2d, ...]:
        return self.boxes, self.directions

    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        """See `BoxHeads.decode`."""
        codes = rows[:, : 7 * self.per_cell].reshape(-1, 7)
        directions = rows[:, 7 * self.per_cell :].reshape(-1, 2)
        return decode_boxes(codes, anchor_boxes(self.anchors, grid, window).to(rows.dtype), directions)

    def candidates(self, logits: Tensor, window: BevWindow) -> Tensor | None:
        """All: anchors of one object compete by their overlap."""
        return None
