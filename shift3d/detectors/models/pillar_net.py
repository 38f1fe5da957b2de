"""Pillar encoders (PointNets) from the points of a pillar to one feature: one layer in PointPillars, two in SST.

Both work without reflectance, because SHIFT3D feeds only xyz. Source: PointPillars (Lang et al. 2019), section 2.1; the
dynamic voxel feature encoder of SST's public configuration (channels 64 and 128).
"""

from __future__ import annotations

from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from shift3d.detectors.grid import Grid, Pillars
from shift3d.detectors.models.folding import folded_linear

DECORATED_CHANNELS = 8
FEATURE_SCALE = (0.03, 0.03, 1.0, 6.0, 6.0, 3.0, 6.0, 6.0)
"""Constant gains that scale the eight inputs to similar magnitude (our choice: the published net feeds metres).
They only precondition training: for inference they are folded into the linear layer that follows."""


def segment_mean(values: Tensor, pillars: Pillars) -> Tensor:
    """Compute the mean of each pillar's rows: (K, C) -> (P, C), summed in row order. Differentiable w.r.t. values."""
    total = torch.segment_reduce(values, "sum", lengths=pillars.counts, axis=0, unsafe=True)
    return total / pillars.counts.to(values.dtype).unsqueeze(1)


def segment_max(rows: Tensor, owner: Tensor, counts: Tensor) -> Tensor:
    """Compute the maximum (P, C) over each pillar's rows (K, C). Differentiable once w.r.t. rows.

    Tied rows get equal shares of the gradient. owner: (K,) int64, ascending, pillar of each row; counts: (P,) int64,
    number of rows per pillar.
    """
    result: Tensor = _SegmentMax.apply(rows, owner, counts)  # type: ignore[no-untyped-call]
    return result


class _SegmentMax(torch.autograd.Function):
    """Segment maximum that splits each gradient between tied rows; torch.segment_reduce (2.13) gives the whole of a
    negative gradient to each tied row. Ties are common: an occluder moves both returns of a beam to one place."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, owner: Tensor, counts: Tensor) -> Tensor:
        highest = torch.segment_reduce(rows, "max", lengths=counts, axis=0, unsafe=True)
        ctx.save_for_backward(rows, highest, owner, counts)
        return highest

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        rows, highest, owner, counts = ctx.saved_tensors
        reached = rows == highest.index_select(0, owner)
        ties = torch.segment_reduce(reached.to(grad.dtype), "sum", lengths=counts, axis=0, unsafe=True)
        return torch.where(reached, (grad / ties).index_select(0, owner), 0.0), None, None


def decorate(points: Tensor, pillars: Pillars, grid: Grid) -> Tensor:
    """Compute (x, y, z), offset from the pillar's mean point, offset (x, y) from the pillar's centre: (K, 8).

    points: (N, 3), network frame, metres. Differentiable w.r.t. points. Source: PointPillars 2.1 (without reflectance).
    """
    xyz = points.index_select(0, pillars.order)
    mean = segment_mean(xyz, pillars)
    centre_x = grid.x_min_m + (pillars.cell_x.to(torch.float64) + 0.5) * grid.cell_m
    centre_y = grid.y_min_m + (pillars.cell_y.to(torch.float64) + 0.5) * grid.cell_m
    centre = torch.stack((centre_x, centre_y), dim=1).to(xyz.dtype)
    to_mean = xyz - mean.index_select(0, pillars.pillar)
    to_centre = xyz[:, :2] - centre.index_select(0, pillars.pillar)
    return torch.cat((xyz, to_mean, to_centre), dim=1)


class PillarNet(nn.Module):
    """Pillar encoder of PointPillars: linear, batch norm, maximum over the pillar, ReLU (commutes with the maximum)."""

    feature_scale: Tensor

    def __init__(self, channels: int = 64) -> None:
        super().__init__()
        self.linear = nn.Linear(DECORATED_CHANNELS, channels, bias=False)
        self.norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=0.01)
        self.register_buffer("feature_scale", torch.tensor(FEATURE_SCALE), persistent=False)

    def forward(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """Encode decorated points (K, 8), metres, to (P, 64). Differentiable; ties share gradients equally."""
        per_point = self.norm(self.linear(decorated * self.feature_scale))
        return torch.relu(segment_max(per_point, pillars.pillar, pillars.counts))

    def folded(self) -> Self:
        """Fold norm and input gains into the layer, in place: the same function in evaluation mode. Return self."""
        self.linear = folded_linear(self.linear, self.norm, self.feature_scale)
        self.norm = nn.Identity()
        self.feature_scale = torch.ones_like(self.feature_scale)
        return self


VOXEL_CHANNELS = 9
VOXEL_FEATURE_SCALE = (*FEATURE_SCALE, 0.5)


def decorate_with_height(points: Tensor, pillars: Pillars, grid: Grid) -> Tensor:
    """Compute the eight values of `decorate` and the height above the pillar's middle, metres: (K, 9).

    points: (N, 3), network frame. Differentiable w.r.t. points. Source: SST's public code (offset from the voxel's
    centre in all three axes).
    """
    decorated = decorate(points, pillars, grid)
    middle = 0.5 * (grid.z_min_m + grid.z_max_m)
    return torch.cat((decorated, decorated[:, 2:3] - middle), dim=1)


class VoxelEncoder(nn.Module):
    """Pillar encoder of SST: linear, norm, ReLU; concatenation with pillar maximum; linear, norm, maximum, ReLU."""

    def __init__(self, hidden: int = 64, channels: int = 128) -> None:
        super().__init__()
        self.first = nn.Linear(VOXEL_CHANNELS, hidden, bias=False)
        self.first_norm: nn.Module = nn.BatchNorm1d(hidden, eps=1e-3, momentum=0.01)
        self.second = nn.Linear(2 * hidden, channels, bias=False)
        self.second_norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=0.01)
        self.register_buffer("feature_scale", torch.tensor(VOXEL_FEATURE_SCALE), persistent=False)

    def forward(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """Encode decorated points (K, 9), metres, sorted by pillar, to (P, channels). Differentiable w.r.t. decorated.

        Points that tie for a maximum get equal shares of the gradient. Points in the same place tie up to a rounding
        that depends on their rows: the sum of their gradients is fixed, the shares are not.
        """
        scale: Tensor = self.feature_scale  # type: ignore[assignment]
        owner, counts = pillars.pillar, pillars.counts
        per_point = torch.relu(self.first_norm(self.first(decorated * scale)))
        joined = torch.cat((per_point, segment_max(per_point, owner, counts).index_select(0, owner)), dim=1)
        # ReLU commutes with the maximum, and there are fewer pillars than points.
        return torch.relu(segment_max(self.second_norm(self.second(joined)), owner, counts))
