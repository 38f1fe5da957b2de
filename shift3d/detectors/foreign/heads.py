"""Heads as OpenPCDet and mmdetection3d compute them: anchors of several classes, and CenterPoint's convolutions."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.foreign.layout import AnchorHead, Branch, CentreHead
from shift3d.detectors.grid import Grid, core_cells
from shift3d.detectors.models.anchor_heads import AnchorConvolutions
from shift3d.detectors.models.centre_heads import decode_centres
from shift3d.detectors.models.folding import folded_sequence
from shift3d.detectors.models.heads import BoxHeads, map_rows


class ForeignAnchorHeads(AnchorConvolutions):
    """1x1 convolutions for the vehicle's logit, the box and the direction of every anchor, those of all classes."""

    def __init__(self, channels: int, head: AnchorHead) -> None:
        super().__init__(channels, len(head.anchors))
        self.head, self.direction_offset_rad = head, head.direction_offset_rad

    def anchor_rows(self, grid: Grid, window: BevWindow) -> Tensor:
        """(A, 7) float64, the model's frame, of the window's core: over y, then x, then the anchors of a cell."""
        lines, columns = core_cells(window)
        boxes = []
        for anchor in self.head.anchors:
            y = _spaced(anchor.y_m, grid.num_y)[lines][:, None].expand(-1, len(columns))
            x = _spaced(anchor.x_m, grid.num_x)[columns].expand(len(lines), -1)
            rest = torch.tensor((anchor.z_m, *anchor.size_m, anchor.heading_rad), dtype=torch.float64)
            boxes.append(torch.cat((torch.stack((x, y), dim=-1), rest.expand(*x.shape, 5)), dim=-1))
        return torch.stack(boxes, dim=2).reshape(-1, 7)


def _spaced(ends: tuple[float, float], count: int) -> Tensor:
    return torch.linspace(*ends, count, dtype=torch.float64)


def _stack(channels: int, hidden: int, branch: Branch, head: CentreHead) -> nn.Sequential:
    modules: list[nn.Module] = []
    for _ in range(branch.layers - 1):
        modules += _convolution(channels, hidden, head)
        channels = hidden
    return nn.Sequential(*modules, nn.Conv2d(channels, branch.outputs, 3, padding=1))


def _convolution(channels: int, outputs: int, head: CentreHead) -> list[nn.Module]:
    layer = nn.Conv2d(channels, outputs, 3, padding=1, bias=head.biased)
    return [layer, nn.BatchNorm2d(outputs, eps=head.eps), nn.ReLU()]


class CentreTower(nn.Module):
    """The shared convolution and the branches of the vehicle's task: features (B, C, h, w) -> (B, 1 + 8, h, w).

    Channels: the vehicle's logit, then offset x and y (cells), z, log of the sizes, and the turn in the source's order.
    Differentiable w.r.t. features through the logit alone: boxes are detached.
    """

    def __init__(self, channels: int, head: CentreHead) -> None:
        super().__init__()
        self.reach = 1 + max(branch.layers for branch in (head.heat, *head.branches[:4]))  # cells to either side
        self.shared = nn.Sequential(*_convolution(channels, head.shared, head))
        self.classes = _stack(head.shared, head.hidden, head.heat, head)
        self.boxes = nn.ModuleList(_stack(head.shared, head.hidden, branch, head) for branch in head.branches[:4])

    def forward(self, features: Tensor) -> Tensor:
        shared = self.shared(features)
        logits = self.classes(shared)
        with torch.no_grad():
            boxes = [branch(shared) for branch in self.boxes]
        return torch.cat((logits, *boxes), dim=1)

    def folded(self) -> Self:
        """The same function in evaluation mode, norms folded into the convolutions, in place."""
        self.shared, self.classes = folded_sequence(self.shared), folded_sequence(self.classes)
        for index, branch in enumerate(self.boxes):
            assert isinstance(branch, nn.Sequential)
            self.boxes[index] = folded_sequence(branch)
        return self


class MapHeads(BoxHeads):
    """Reads what a `CentreTower` gave: a cell's logit and box code. The sources ask for no peaks."""

    per_cell = 1
    box_layers = ()
    layers = ()

    def logits(self, features: Tensor) -> Tensor:
        return map_rows(features[:, :1]).flatten(1)

    def box_rows(self, features: Tensor) -> Tensor:
        return map_rows(features[:, 1:])

    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        """See `BoxHeads.decode`. The sources count the offset from the cell's corner.

        Source: OpenPCDet's centernet_utils, mmdetection3d's CenterPointBBoxCoder.
        """
        lines, columns = core_cells(window)
        y, x = torch.meshgrid(lines, columns, indexing="ij")
        codes = torch.cat((rows[:, :2] - 0.5, rows[:, 2:]), dim=1)
        return decode_centres(codes, torch.stack((x.reshape(-1), y.reshape(-1)), dim=1), grid)
