"""The pillar network as OpenPCDet and mmdetection3d compute it."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor, nn

from shift3d.detectors.foreign.layout import PillarInputs
from shift3d.detectors.grid import Grid, Pillars
from shift3d.detectors.models.folding import folded_linear
from shift3d.detectors.models.pillar_net import decorate


def foreign_inputs(points: Tensor, pillars: Pillars, grid: Grid, inputs: PillarInputs) -> Tensor:
    """Place, constants, offset to the pillar's mean, offset to its centre in x, y, z: (K, columns), by pillar.

    points: (N, 3), the model's frame, metres. Differentiable w.r.t. points.
    Source: OpenPCDet's PillarVFE; mmdetection3d's PillarFeatureNet, whose `legacy` writes the offset to the centre over
    the coordinates.
    """
    decorated = decorate(points, pillars, grid)
    xyz, to_mean = decorated[:, :3], decorated[:, 3:6]
    to_centre = torch.cat((decorated[:, 6:], xyz[:, 2:] - inputs.middle_m), dim=1)
    place = {"coordinates": xyz, "offset": to_centre, "none": xyz[:, :0]}[inputs.position]
    constants = xyz.new_tensor(inputs.constants).expand(len(xyz), -1)
    return torch.cat((place, constants, to_mean, to_centre), dim=1)


class ForeignEncoder(nn.Module):
    """Layers of linear, norm and ReLU; each but the last joins a point with its pillar's maximum.

    Both codebases fill a pillar up to its slots with zeros after decoration and take the maximum over these, too: in a
    pillar with fewer points, one of zeros stands for all of them. A pillar that is full keeps every point (our choice:
    the sources keep as many as it has slots, which ones depends on the order of the points).
    """

    def __init__(self, inputs: PillarInputs) -> None:
        super().__init__()
        self.slots = inputs.slots
        halves = [*(width // 2 for width in inputs.filters[:-1]), inputs.filters[-1]]
        sources = [inputs.columns, *inputs.filters[:-1]]
        self.linears = nn.ModuleList(
            nn.Linear(source, width, bias=False) for source, width in zip(sources, halves, strict=True)
        )
        self.norms = nn.ModuleList(nn.BatchNorm1d(width, eps=inputs.eps) for width in halves)

    def forward(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """(K, columns), sorted by pillar -> (P, channels). Differentiable w.r.t. decorated.

        Of points that tie for a maximum, the first one in order of coordinates gets the gradient.
        """
        features, owner, counts = decorated, pillars.pillar, pillars.counts
        if self.slots is not None:
            short = torch.nonzero(counts < self.slots).flatten()
            owner = torch.cat((owner, short))
            order = torch.argsort(owner, stable=True)
            features = torch.cat((features, features.new_zeros(len(short), features.shape[1]))).index_select(0, order)
            owner, counts = owner.index_select(0, order), counts + (counts < self.slots)
        for index, (linear, norm) in enumerate(zip(self.linears, self.norms, strict=True)):
            features = torch.relu(norm(linear(features)))
            highest = _highest(features, owner, counts)
            if index + 1 < len(self.linears):
                features = torch.cat((features, highest.index_select(0, owner)), dim=1)
        return highest

    def folded(self) -> Self:
        """The same function in evaluation mode, norms folded into the layers, in place."""
        for index, (linear, norm) in enumerate(zip(self.linears, self.norms, strict=True)):
            assert isinstance(linear, nn.Linear)
            self.linears[index], self.norms[index] = folded_linear(linear, norm), nn.Identity()
        return self


def _highest(features: Tensor, owner: Tensor, counts: Tensor) -> Tensor:
    """(P, C) maximum over each pillar's rows (K, C).

    Rows tie as soon as the layers before left nothing of them but their pillar's maximum. torch.segment_reduce shares
    a gradient between them only where it is positive (2.13: a negative one is given to each in full).
    """
    with torch.no_grad():
        highest = torch.segment_reduce(features, "max", lengths=counts, axis=0, unsafe=True)
        rows = torch.arange(len(features))[:, None].expand_as(features)
        rows = torch.where(features == highest.index_select(0, owner), rows, len(features))
        first = rows.new_full(highest.shape, len(features) - 1)
        first = first.scatter_reduce(0, owner[:, None].expand_as(features), rows, "amin")
    return features.gather(0, first)
