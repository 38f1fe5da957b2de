"""What a detector's heads offer, whatever they predict against: class logits with gradients, boxes, candidates."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, core_cells


class BoxHeads(nn.Module, ABC):
    """1x1 convolutions on the features of every cell: one for class logits, others for boxes.

    Rows are cells, over y, then x. A cell has `per_cell` proposals, which are neighbours in every list of proposals.
    """

    per_cell: int
    classes: nn.Conv2d

    @property
    @abstractmethod
    def box_layers(self) -> tuple[nn.Conv2d, ...]:
        """The convolutions beside that of the class logits, in the order of `decode`'s columns."""

    @abstractmethod
    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        """Boxes (A, 7), metres, network frame, of the window's core.

        rows: (cells, R), what `box_layers` gave, side by side. Not differentiable: boxes are detached.
        """

    def reported(self, logits: Tensor, window: BevWindow) -> Tensor | None:
        """(A,) bool, the proposals of the window's core that suppression is given; None: all."""
        return None

    @property
    def layers(self) -> tuple[nn.Conv2d, ...]:
        """Every convolution, that of the class logits first."""
        return (self.classes, *self.box_layers)

    def logits(self, features: Tensor) -> Tensor:
        """(B, A) class logits alone, for a backward pass that needs nothing else."""
        return map_rows(self.classes(features)).flatten(1)

    def box_rows_at(self, features: Tensor, cells: Tensor) -> Tensor:
        """(P, R): what `box_layers` give at cells (P,) of one map's features (C, h, w), in the weights' precision.

        For training, which asks for a few dozen cells of thousands. Differentiable w.r.t. features and weights.
        """
        rows = features.permute(1, 2, 0).flatten(0, 1).index_select(0, cells)
        weight = torch.cat([layer.weight.flatten(1) for layer in self.box_layers])
        bias = torch.cat([layer.bias for layer in self.box_layers if layer.bias is not None])
        return functional.linear(rows.to(weight.dtype), weight, bias)

    def box_rows(self, features: Tensor) -> Tensor:
        """(B, cells, R): what `box_layers` give."""
        return torch.cat([map_rows(layer(features)) for layer in self.box_layers], dim=2)


def map_rows(output: Tensor) -> Tensor:
    """What a convolution gave as rows: (B, C, h, w) -> (B, h w, C)."""
    return output.permute(0, 2, 3, 1).flatten(1, 2)


def proposal_indices(per_cell: int, grid: Grid, window: BevWindow) -> Tensor:
    """Index of each of the core's proposals among those of the full grid: (A,) int64."""
    lines, columns = core_cells(window)
    cells = lines[:, None] * grid.num_x + columns[None, :]
    return (cells[..., None] * per_cell + torch.arange(per_cell)).reshape(-1)
