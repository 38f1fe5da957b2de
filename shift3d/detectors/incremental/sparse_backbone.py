"""The pillar detectors' backbone and heads evaluated cell by cell: what changed and is needed, and nothing else.

A convolution of chosen cells is a matrix product of their gathered 3x3 neighbourhoods. On one core of the machine at
hand that runs as fast per operation as a dense convolution (75 to 83 GFLOP/s against 55 to 84 in float32), so that
operations saved are time saved, whatever shape the chosen cells have.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from shift3d.detectors.incremental.active_sites import ActiveSites, MapShape, empty_set, pooled, sources
from shift3d.detectors.models.backbone import Backbone
from shift3d.detectors.models.heads import BoxHeads

ROWS_AT_ONCE = 1024
"""Neighbourhoods gathered at once, at most: 9 MB of float32 at 256 channels, which the caches hold."""


@dataclass(frozen=True)
class _Convolution:
    """weight: (c_out, 9 c_in), columns by the kernel's row, its column, the channel. bias: (c_out,)."""

    weight: Tensor
    bias: Tensor
    stride: int


@dataclass(frozen=True)
class _Branch:
    """A block's way to the heads.

    up_weight: (s² u, c), rows by line and column within the cell, then channel; up_bias: (s² u,). heads: (u, h), the
    heads' columns for this branch, in the precision that must be exact.
    """

    last_layer: int
    factor: int
    up_weight: Tensor
    up_bias: Tensor
    heads: Tensor


class SparseBackbone:
    """The folded backbone and heads as matrices. Nothing here changes once made; any number of caches share it."""

    def __init__(self, backbone: Backbone, heads: BoxHeads, exact: torch.dtype) -> None:
        """backbone, heads: folded, for inference. exact: dtype of logits and box codes."""
        self.exact = exact
        chain: list[_Convolution] = []
        branches = []
        kinds = heads.layers
        head_rows = torch.cat([kind.weight.flatten(1) for kind in kinds]).detach().to(exact)
        self.head_bias = torch.cat([kind.bias for kind in kinds if kind.bias is not None]).detach().to(exact)
        self.per_cell = heads.per_cell
        self.out_stride = backbone.spec.out_stride
        first = 0
        for block, up, stride in zip(backbone.blocks, backbone.ups, backbone.spec.total_strides, strict=True):
            factor = stride // self.out_stride
            chain += [_convolution(layer) for layer in block.modules() if isinstance(layer, nn.Conv2d)]
            (layer,) = (part for part in up.modules() if isinstance(part, nn.ConvTranspose2d))
            assert layer.bias is not None
            weight = layer.weight.detach().permute(2, 3, 1, 0).flatten(0, 2)
            columns = head_rows[:, first : first + layer.out_channels]
            bias = layer.bias.detach().repeat(factor**2)
            branches.append(_Branch(len(chain) - 1, factor, weight.contiguous(), bias, columns.t().contiguous()))
            first += layer.out_channels
        self.chain = tuple(chain)
        self.branches = tuple(branches)

    def shapes(self, window: MapShape) -> list[MapShape]:
        """Of the input and of every layer's output."""
        result = [window]
        for layer in self.chain:
            result.append(result[-1].strided(layer.stride))
        return result

    def output_shape(self, window: MapShape) -> MapShape:
        """Of the map that the heads read. window: of the input, a multiple of the stride."""
        return MapShape(window.height // self.out_stride, window.width // self.out_stride)

    def needed(self, outputs: ActiveSites) -> list[ActiveSites]:
        """The cells of the input and of every layer that the features of these output cells depend on."""
        height, width = (self.out_stride * (cells - 2) for cells in outputs.shape)
        shapes = self.shapes(MapShape(height, width))
        result = [empty_set(shape) for shape in shapes]
        for branch in self.branches:
            result[branch.last_layer + 1] |= pooled(outputs, branch.factor)
        for index in range(len(self.chain), 0, -1):
            result[index - 1] |= sources(result[index], self.chain[index - 1].stride, shapes[index - 1])
        return result


def _convolution(layer: nn.Conv2d) -> _Convolution:
    assert layer.bias is not None and layer.kernel_size == (3, 3) and layer.padding == (1, 1)
    weight = layer.weight.detach().permute(0, 2, 3, 1).flatten(1).contiguous()
    return _Convolution(weight, layer.bias.detach(), layer.stride[0])
