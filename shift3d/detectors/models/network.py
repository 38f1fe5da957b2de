"""What a detector's network and its heads offer: features of a window's core, how far they reach, logits and boxes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal, Self

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, Pillars, assign_pillars, core_cells, side_by_side

Precision = Literal["float32", "bfloat16", "float64"]


def arithmetic(precision: Precision) -> tuple[torch.dtype, torch.dtype]:
    """(dtype of what must be exact, dtype of the large products) of a precision."""
    exact = torch.float64 if precision == "float64" else torch.float32
    return exact, torch.bfloat16 if precision == "bfloat16" else exact


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


class DetectorNet(nn.Module, ABC):
    """Points -> one feature a cell -> class logits and boxes of its proposals. channels: of a pillar's feature."""

    name: str
    grid: Grid
    heads: BoxHeads
    channels: int

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
    def decorated(self, points: Tensor, pillars: Pillars) -> Tensor:
        """What the encoder is given of points (N, 3), network frame, metres: (K, inputs), sorted by pillar."""

    @abstractmethod
    def encode(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """(K, inputs) -> one feature a pillar (P, channels). Differentiable w.r.t. decorated."""

    def batch_features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> tuple[Sequence[Pillars], Tensor]:
        """The pillars that hold a point of each window, and the features (P, channels) of all, window by window.

        clouds: (N_b, 3), network frame, metres. pillars: those of each window, where they are at hand. Differentiable
        w.r.t. the points.
        """
        if pillars is None:
            pairs = zip(clouds, windows, strict=True)
            pillars = [assign_pillars(points, self.grid, window) for points, window in pairs]
        together = side_by_side(pillars, [len(points) for points in clouds])
        decorated = self.decorated(torch.cat(list(clouds)), together)
        if not len(together.counts):
            return pillars, decorated.new_zeros(0, self.channels)
        with torch.autocast(decorated.device.type, enabled=False):  # bfloat16 knows a coordinate to 0.3 m at 70 m
            return pillars, self.encode(decorated, together)

    def pillar_features(self, points: Tensor, window: BevWindow) -> tuple[Pillars, Tensor]:
        """`batch_features` of one window."""
        (pillars,), features = self.batch_features([points], [window])
        return pillars, features

    @abstractmethod
    def features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> Tensor:
        """(B, C, h, w) of the windows' cores; windows of equal shape. clouds: (N_b, 3), network frame, metres.

        pillars: those of each window, where they are at hand. Differentiable w.r.t. points and weights.
        """

    @abstractmethod
    def inference(self, precision: Precision) -> Self:
        """The same function in evaluation mode, folded, in a precision; parameters need no gradient."""

    def forward(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> Tensor:
        """(B, A) class logits of the windows' cores. Differentiable w.r.t. points and weights."""
        return self.heads.logits(self.features(clouds, windows))
