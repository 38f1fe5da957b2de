"""Base classes of detector networks and heads: features of a window's core, receptive field, logits and boxes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal, Self

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid, Pillars, assign_pillars, concatenate_pillars, core_cells

Precision = Literal["float32", "bfloat16", "float64"]


def precision_dtypes(precision: Precision) -> tuple[torch.dtype, torch.dtype]:
    """Return the exact dtype and the dtype of the large matrix products of a precision."""
    exact = torch.float64 if precision == "float64" else torch.float32
    return exact, torch.bfloat16 if precision == "bfloat16" else exact


class BoxHeads(nn.Module, ABC):
    """1x1 convolutions on the features of every cell: one for class logits, others for boxes.

    Rows are cells, ordered by y, then x. A cell has `per_cell` proposals, which are adjacent in all proposal tensors.
    """

    per_cell: int
    classes: nn.Conv2d

    @property
    @abstractmethod
    def box_layers(self) -> tuple[nn.Conv2d, ...]:
        """Convolutions other than `classes`, in the column order of `decode`."""

    @abstractmethod
    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        """Return the core's boxes (A, 7), metres, network frame, detached. rows: (cells, R) of all `box_layers`.

        grid: of the heads. window: in its cells.
        """

    def reported(self, logits: Tensor, window: BevWindow) -> Tensor | None:
        """Return a mask (A,) bool of the core's proposals that enter suppression; None: all. window: as in `decode`."""
        return None

    @property
    def layers(self) -> tuple[nn.Conv2d, ...]:
        """All convolutions, `classes` first."""
        return (self.classes, *self.box_layers)

    def logits(self, features: Tensor) -> Tensor:
        """Compute only the class logits (B, A), for a backward pass that needs no boxes."""
        return map_to_rows(self.classes(features)).flatten(1)

    def box_rows_at(self, features: Tensor, cells: Tensor) -> Tensor:
        """Compute the outputs (P, R) of `box_layers` at cells (P,) of one feature map (C, h, w), in the weights' dtype.

        For training, which needs a few dozen of thousands of cells. Differentiable w.r.t. features and weights.
        """
        rows = features.permute(1, 2, 0).flatten(0, 1).index_select(0, cells)
        weight = torch.cat([layer.weight.flatten(1) for layer in self.box_layers])
        bias = torch.cat([layer.bias for layer in self.box_layers if layer.bias is not None])
        return functional.linear(rows.to(weight.dtype), weight, bias)

    def box_rows(self, features: Tensor) -> Tensor:
        """Compute the outputs (B, cells, R) of `box_layers`."""
        return torch.cat([map_to_rows(layer(features)) for layer in self.box_layers], dim=2)


def map_to_rows(output: Tensor) -> Tensor:
    """Reshape the output of a convolution to rows: (B, C, h, w) -> (B, h w, C)."""
    return output.permute(0, 2, 3, 1).flatten(1, 2)


def proposal_indices(per_cell: int, grid: Grid, window: BevWindow) -> Tensor:
    """Return the index of each of the core's proposals in the full grid: (A,) int64. window: in cells of the grid."""
    lines, columns = core_cells(window)
    cells = lines[:, None] * grid.num_x + columns[None, :]
    return (cells[..., None] * per_cell + torch.arange(per_cell)).reshape(-1)


class DetectorNet(nn.Module, ABC):
    """Network from points to features per cell to class logits and boxes. channels: size of a pillar's feature."""

    name: str
    grid: Grid
    heads: BoxHeads
    channels: int

    @abstractmethod
    def core_span(self, low: int, high: int, cells: int) -> tuple[int, int]:
        """Return the smallest valid core interval that covers [low, high) on an axis of `cells` cells."""

    @abstractmethod
    def outer_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        """Return the interval of the axis that the proposals of a core depend on."""

    @property
    def head_grid(self) -> Grid:
        """Grid of the cells that have proposals."""
        return self.grid

    def head_window(self, window: BevWindow) -> BevWindow:
        """Convert a window from cells of `grid` to cells of `head_grid`."""
        return window

    @abstractmethod
    def decorated(self, points: Tensor, pillars: Pillars) -> Tensor:
        """Compute the encoder inputs (K, inputs), sorted by pillar, of points (N, 3), network frame, metres."""

    @abstractmethod
    def encode(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """Encode (K, inputs) to one feature per pillar (P, channels). Differentiable w.r.t. decorated."""

    def batch_features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> tuple[Sequence[Pillars], Tensor]:
        """Return the non-empty pillars of each window and the features (P, channels) of all, window by window.

        clouds: (N_b, 3), network frame, metres. pillars: of each window, if computed. Differentiable w.r.t. the points.
        """
        if pillars is None:
            pairs = zip(clouds, windows, strict=True)
            pillars = [assign_pillars(points, self.grid, window) for points, window in pairs]
        together = concatenate_pillars(pillars, [len(points) for points in clouds])
        decorated = self.decorated(torch.cat(list(clouds)), together)
        if not len(together.counts):
            return pillars, decorated.new_zeros(0, self.channels)
        with torch.autocast(decorated.device.type, enabled=False):  # bfloat16 resolves only 0.3 m at 70 m
            return pillars, self.encode(decorated, together)

    def pillar_features(self, points: Tensor, window: BevWindow) -> tuple[Pillars, Tensor]:
        """Compute `batch_features` for one window."""
        (pillars,), features = self.batch_features([points], [window])
        return pillars, features

    @abstractmethod
    def features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> Tensor:
        """Compute features (B, C, h, w) of the cores of equally shaped windows. Differentiable w.r.t. points, weights.

        clouds: (N_b, 3), network frame, metres. pillars: of each window, if already computed.
        """

    @abstractmethod
    def inference(self, precision: Precision) -> Self:
        """Return the same function in evaluation mode, folded, in a precision; parameters need no gradient."""

    def forward(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> Tensor:
        """Compute class logits (B, A) of the windows' cores. Differentiable w.r.t. points and weights."""
        return self.heads.logits(self.features(clouds, windows))
