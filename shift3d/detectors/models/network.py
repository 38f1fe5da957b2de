"""What a detector's network offers: features of a window's core, how far they reach, and heads."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal, Self

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.heads import BoxHeads

Precision = Literal["float32", "bfloat16", "float64"]


def arithmetic(precision: Precision) -> tuple[torch.dtype, torch.dtype]:
    """(dtype of what must be exact, dtype of the large products) of a precision."""
    exact = torch.float64 if precision == "float64" else torch.float32
    return exact, torch.bfloat16 if precision == "bfloat16" else exact


class DetectorNet(nn.Module, ABC):
    """Points -> one feature a cell -> class logits and boxes of the cell's proposals."""

    name: str
    grid: Grid
    heads: BoxHeads

    @abstractmethod
    def core_span(self, low: int, high: int, cells: int) -> tuple[int, int]:
        """The smallest stretch of an axis of `cells` cells that covers [low, high) and can be a core."""

    @abstractmethod
    def outer_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        """The stretch of the axis that a core's result depends on."""

    @property
    def head_grid(self) -> Grid:
        """The grid of the cells that have proposals."""
        return self.grid

    def head_window(self, window: BevWindow) -> BevWindow:
        """A window in cells of `head_grid`."""
        return window

    @abstractmethod
    def features(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> Tensor:
        """(B, C, h, w) of the windows' cores; windows of equal shape. clouds: (N_b, 3), network frame, metres.

        Differentiable w.r.t. points and weights.
        """

    @abstractmethod
    def inference(self, precision: Precision) -> Self:
        """The same function in evaluation mode, folded, in a precision; parameters need no gradient."""

    def forward(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> Tensor:
        """(B, A) class logits of the windows' cores. Differentiable w.r.t. points and weights."""
        return self.heads.logits(self.features(clouds, windows))
