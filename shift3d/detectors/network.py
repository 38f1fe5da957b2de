"""PointPillars as one module, for training and, with batch norm folded away, for inference."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from shift3d.detectors.backbone import WAYMO_BACKBONE, Backbone, BackboneSpec, HeadOutputs, Heads
from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID, Grid, Pillars, assign_pillars
from shift3d.detectors.pillar_net import PillarNet, decorate

__all__ = ["PointPillarsNet", "fold_batch_norms"]


class PointPillarsNet(nn.Module):
    """Points -> logits, codes, direction logits of every anchor in the window's core.

    Source: PointPillars (Lang et al. 2019) in the Waymo configuration that SHIFT3D follows; dynamic
    voxelisation instead of at most 20 points a pillar (our choice: see shift3d.detectors.grid).
    """

    def __init__(self, spec: BackboneSpec = WAYMO_BACKBONE, grid: Grid = WAYMO_GRID) -> None:
        super().__init__()
        self.grid = grid
        self.pillar_net = PillarNet(spec.in_channels)
        self.backbone = Backbone(spec)
        self.heads = Heads(spec)

    def canvas(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> Tensor:
        """Pillar features on the dense grid: (B, C, H, W), channels last in memory, zero where no point is.

        clouds: (N_b, 3) each, network frame. Differentiable w.r.t. the points.
        """
        height, width = windows[0].num_y, windows[0].num_x
        decorated, flat_cells, counts, points_before, pillars_before = [], [], [], 0, 0
        owner = []
        for index, (points, window) in enumerate(zip(clouds, windows, strict=True)):
            pillars = assign_pillars(points, self.grid, window)
            decorated.append(decorate(points, pillars, self.grid))
            rows = pillars.cell_y - window.y0 + index * height
            flat_cells.append(rows * width + pillars.cell_x - window.x0)
            counts.append(pillars.counts)
            owner.append(pillars.pillar + pillars_before)
            points_before += pillars.order.numel()
            pillars_before += pillars.counts.numel()
        channels = self.pillar_net.linear.out_features
        dense = decorated[0].new_zeros(len(clouds) * height * width, channels)
        if points_before:
            empty = torch.empty(0, dtype=torch.int64)
            joint = Pillars(empty, torch.cat(owner), torch.cat(counts), empty, empty)
            features = self.pillar_net(torch.cat(decorated), joint)
            dense = dense.index_copy(0, torch.cat(flat_cells), features)
        return dense.view(len(clouds), height, width, channels).permute(0, 3, 1, 2)

    def forward(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> HeadOutputs:
        """One result for the batch; windows of equal shape. Differentiable w.r.t. points and weights."""
        features = self.backbone(self.canvas(clouds, windows), core_in_window(windows[0]))
        outputs: HeadOutputs = self.heads(features)
        return outputs


def core_in_window(window: BevWindow) -> tuple[int, int, int, int]:
    """(y0, x0, height, width) of the core in the window's own cells."""
    return (
        window.core_y0 - window.y0,
        window.core_x0 - window.x0,
        window.core_num_y,
        window.core_num_x,
    )


def _scale_and_shift(norm: nn.BatchNorm1d | nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    assert norm.running_mean is not None and norm.running_var is not None
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    return scale, norm.bias.double() - norm.running_mean.double() * scale


def _folded_convolution(layer: nn.Module, norm: nn.BatchNorm2d) -> nn.Module:
    scale, shift = _scale_and_shift(norm)
    folded = copy.deepcopy(layer)
    assert isinstance(folded, nn.Conv2d | nn.ConvTranspose2d)
    shape = (1, -1, 1, 1) if isinstance(folded, nn.ConvTranspose2d) else (-1, 1, 1, 1)
    dtype = folded.weight.dtype
    folded.weight = nn.Parameter((folded.weight.double() * scale.view(shape)).to(dtype))
    folded.bias = nn.Parameter(shift.to(dtype))
    return folded


def _folded_sequence(sequence: nn.Sequential) -> nn.Sequential:
    modules: list[nn.Module] = []
    for module in sequence:
        if isinstance(module, nn.BatchNorm2d):
            modules[-1] = _folded_convolution(modules[-1], module)
        else:
            modules.append(module)
    return nn.Sequential(*modules)


def fold_batch_norms(net: PointPillarsNet) -> PointPillarsNet:
    """The same function in evaluation mode, batch norms and input gains moved into the layer before.

    Returns a new module; folding is done in float64. Parameters need no gradient.
    """
    folded = copy.deepcopy(net).eval()
    norm = net.pillar_net.norm
    assert isinstance(norm, nn.BatchNorm1d)
    scale, shift = _scale_and_shift(norm)
    old = net.pillar_net.linear
    linear = nn.Linear(old.in_features, old.out_features)
    gains: Tensor = net.pillar_net.feature_scale  # type: ignore[assignment]
    linear.weight = nn.Parameter((old.weight.double() * scale[:, None] * gains.double()).to(old.weight.dtype))
    linear.bias = nn.Parameter(shift.to(old.weight.dtype))
    folded.pillar_net.linear = linear
    folded.pillar_net.norm = nn.Identity()
    folded.pillar_net.feature_scale = torch.ones_like(gains)
    for group in (folded.backbone.blocks, folded.backbone.ups):
        for index, sequence in enumerate(group):
            assert isinstance(sequence, nn.Sequential)
            group[index] = _folded_sequence(sequence)
    return folded.requires_grad_(False)
