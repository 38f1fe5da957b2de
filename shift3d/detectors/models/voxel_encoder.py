"""Points of a pillar -> one feature, in two PointNet layers with the pillar's maximum fed back in between.

Source: the dynamic voxel feature encoder of SST's public configuration (channels 64 and 128), without
reflectance, as SHIFT3D feeds xyz alone.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from shift3d.detectors.grid import Grid, Pillars
from shift3d.detectors.models.pillar_net import FEATURE_SCALE, decorate

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
        per_point = torch.relu(self.first_norm(self.first(decorated * scale)))
        joined = torch.cat((per_point, _highest(per_point, pillars).index_select(0, pillars.pillar)), dim=1)
        # ReLU commutes with the maximum, and there are fewer pillars than points.
        return torch.relu(_highest(self.second_norm(self.second(joined)), pillars))


def _highest(per_point: Tensor, pillars: Pillars) -> Tensor:
    return torch.segment_reduce(per_point, "max", lengths=pillars.counts, axis=0, unsafe=True)
