"""PointNets of a pillar: its points -> one feature. PointPillars has one layer, SST two, both without reflectance, as
SHIFT3D feeds xyz alone.

Source: PointPillars (Lang et al. 2019), section 2.1; the dynamic voxel feature encoder of SST's public configuration
(channels 64 and 128).
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
"""Constant gains that bring the eight inputs to like magnitude (our choice: the published net feeds metres).
They only precondition training: a linear layer follows, into which they are folded for inference."""


def segment_mean(values: Tensor, pillars: Pillars) -> Tensor:
    """Mean of each pillar's rows: (K, C) -> (P, C), summed in sorted order. Differentiable w.r.t. values."""
    total = torch.segment_reduce(values, "sum", lengths=pillars.counts, axis=0, unsafe=True)
    return total / pillars.counts.to(values.dtype).unsqueeze(1)


def segment_max(rows: Tensor, owner: Tensor, counts: Tensor) -> Tensor:
    """(P, C) maximum over each pillar's rows (K, C). Differentiable once w.r.t. rows; those that tie share alike.

    owner: (K,) int64, rising, the pillar of each row; counts: (P,) int64, rows of each.
    """
    result: Tensor = _SegmentMax.apply(rows, owner, counts)  # type: ignore[no-untyped-call]
    return result


class _SegmentMax(torch.autograd.Function):
    """torch.segment_reduce shares a gradient between ties only where it is positive (2.13: a negative one is given to
    each in full). Ties are no rarity: what stands before both returns of a beam moves them to one place."""

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
    """(x, y, z), offset to the pillar's mean point, offset (x, y) to the pillar's centre: (K, 8).

    points: (N, 3), network frame, metres. Differentiable w.r.t. points.
    Source: PointPillars 2.1 (without reflectance).
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
    """Linear, batch norm, maximum over the pillar, ReLU (which commutes with the maximum)."""

    feature_scale: Tensor

    def __init__(self, channels: int = 64) -> None:
        super().__init__()
        self.linear = nn.Linear(DECORATED_CHANNELS, channels, bias=False)
        self.norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=0.01)
        self.register_buffer("feature_scale", torch.tensor(FEATURE_SCALE), persistent=False)

    def forward(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """(K, 8) decorated points, metres -> (P, 64) pillar features. Differentiable w.r.t. decorated.

        Of points that tie for a maximum, each gets an equal share of the gradient.
        """
        per_point = self.norm(self.linear(decorated * self.feature_scale))
        return torch.relu(segment_max(per_point, pillars.pillar, pillars.counts))

    def folded(self) -> Self:
        """The same function in evaluation mode, norm and input gains folded into the layer, in place."""
        self.linear = folded_linear(self.linear, self.norm, self.feature_scale)
        self.norm = nn.Identity()
        self.feature_scale = torch.ones_like(self.feature_scale)
        return self


VOXEL_CHANNELS = 9
VOXEL_FEATURE_SCALE = (*FEATURE_SCALE, 0.5)


def decorate_with_height(points: Tensor, pillars: Pillars, grid: Grid) -> Tensor:
    """The eight values of PointPillars and the height above the pillar's middle, metres: (K, 9).

    points: (N, 3), network frame. Differentiable w.r.t. points. Source: SST's public code (offset to the voxel's
    centre in all three axes).
    """
    decorated = decorate(points, pillars, grid)
    middle = 0.5 * (grid.z_min_m + grid.z_max_m)
    return torch.cat((decorated, decorated[:, 2:3] - middle), dim=1)


class VoxelEncoder(nn.Module):
    """Linear, batch norm, ReLU on each point; each point joined with its pillar's maximum; once more; maximum."""

    def __init__(self, hidden: int = 64, channels: int = 128) -> None:
        super().__init__()
        self.first = nn.Linear(VOXEL_CHANNELS, hidden, bias=False)
        self.first_norm: nn.Module = nn.BatchNorm1d(hidden, eps=1e-3, momentum=0.01)
        self.second = nn.Linear(2 * hidden, channels, bias=False)
        self.second_norm: nn.Module = nn.BatchNorm1d(channels, eps=1e-3, momentum=0.01)
        self.register_buffer("feature_scale", torch.tensor(VOXEL_FEATURE_SCALE), persistent=False)

    def forward(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """(K, 9) decorated points, metres, sorted by pillar -> (P, channels). Differentiable w.r.t. decorated.

        Of points that tie for a maximum, each gets an equal share of the gradient. Points in one and the same
        place tie up to a rounding that depends on their rows: what they get together is fixed, the shares are not.
        """
        scale: Tensor = self.feature_scale  # type: ignore[assignment]
        owner, counts = pillars.pillar, pillars.counts
        per_point = torch.relu(self.first_norm(self.first(decorated * scale)))
        joined = torch.cat((per_point, segment_max(per_point, owner, counts).index_select(0, owner)), dim=1)
        # ReLU commutes with the maximum, and there are fewer pillars than points.
        return torch.relu(segment_max(self.second_norm(self.second(joined)), owner, counts))
