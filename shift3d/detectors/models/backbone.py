"""2D convolutional backbone of PointPillars and CenterPoint (Waymo configuration)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class BackboneSpec:
    """Sizes of the blocks: a strided 3x3 convolution, `layers` more, then resampling to the stride `out_stride`."""

    in_channels: int = 64
    strides: tuple[int, ...] = (1, 2, 2)
    layers: tuple[int, ...] = (3, 5, 5)
    channels: tuple[int, ...] = (64, 128, 256)
    up_channels: int = 128
    out_stride: int = 1

    @property
    def total_strides(self) -> tuple[int, ...]:
        """Stride of each block's output relative to the input grid."""
        product, result = 1, []
        for stride in self.strides:
            product *= stride
            result.append(product)
        return tuple(result)

    @property
    def coarsest_stride(self) -> int:
        """Stride of the coarsest map (of a block or the output); windows are aligned to it."""
        return max(self.total_strides[-1], self.out_stride)

    @property
    def margin_cells(self) -> int:
        """Radius of an output cell's receptive field in input cells (the larger side).

        Computed backwards layer by layer, for every phase of an output cell relative to the deepest block's stride.
        """
        reach = 0
        for block in range(len(self.strides)):
            deepest = self.total_strides[block]
            low = high = 0  # interval of cells that output cell 0 of this block needs
            for index in range(block, -1, -1):
                low, high = low - self.layers[index], high + self.layers[index]
                low, high = low * self.strides[index] - 1, high * self.strides[index] + 1
            reach = max(reach, deepest - 1 - low, high)
        return reach


WAYMO_BACKBONE = BackboneSpec()


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3, momentum=0.01)


def _block(in_channels: int, channels: int, stride: int, layers: int) -> nn.Sequential:
    modules: list[nn.Module] = []
    for index in range(layers + 1):
        source, step = (in_channels, stride) if index == 0 else (channels, 1)
        modules += [nn.Conv2d(source, channels, 3, step, padding=1, bias=False), _norm(channels), nn.ReLU(inplace=True)]
    return nn.Sequential(*modules)


def _upsampling(in_channels: int, channels: int, stride: int, out_stride: int) -> nn.Sequential:
    if stride >= out_stride:
        factor = stride // out_stride
        layer: nn.Module = nn.ConvTranspose2d(in_channels, channels, factor, factor, bias=False)
    else:
        factor = out_stride // stride
        layer = nn.Conv2d(in_channels, channels, factor, factor, bias=False)
    return nn.Sequential(layer, _norm(channels), nn.ReLU(inplace=True))


class Backbone(nn.Module):
    """Network from a dense pillar map (B, 64, H, W) to features (B, 384, h, w) of the core at stride `out_stride`."""

    def __init__(self, spec: BackboneSpec = WAYMO_BACKBONE) -> None:
        super().__init__()
        self.spec = spec
        sources = (spec.in_channels, *spec.channels[:-1])
        self.blocks = nn.ModuleList(
            _block(*sizes) for sizes in zip(sources, spec.channels, spec.strides, spec.layers, strict=True)
        )
        self.ups = nn.ModuleList(
            _upsampling(channels, spec.up_channels, stride, spec.out_stride)
            for channels, stride in zip(spec.channels, spec.total_strides, strict=True)
        )

    def forward(self, canvas: Tensor, core: tuple[int, int, int, int] | None = None) -> Tensor:
        """Compute the features of the core. Differentiable w.r.t. canvas.

        canvas: (B, C, H, W), H along y. core: (y0, x0, height, width), cells, aligned to the stride. In evaluation mode
        a layer computes only cells that the core depends on: 0.6 of the operations for a loss window, 0.7 for a score.
        """
        y0, x0, height, width = core or (0, 0, canvas.shape[2], canvas.shape[3])
        lines = self._input_spans(canvas.shape[2], y0, height)
        columns = self._input_spans(canvas.shape[3], x0, width)
        outputs = []
        features, origin, layer = canvas, (0, 0), 0
        for block, up, stride in zip(self.blocks, self.ups, self.spec.total_strides, strict=True):
            for module in block:  # type: ignore[attr-defined]
                if isinstance(module, nn.Conv2d):
                    features = _cut(features, origin, lines[layer], columns[layer])
                    step = module.stride[0]
                    origin = (lines[layer][0] // step, columns[layer][0] // step)
                    layer += 1
                features = module(features)
            rows = (y0 // stride, (y0 + height) // stride)
            outputs.append(up(_cut(features, origin, rows, (x0 // stride, (x0 + width) // stride))))
        return torch.cat(outputs, dim=1)

    def _input_spans(self, cells: int, low: int, size: int) -> list[tuple[int, int]]:
        """Return for each 3x3 convolution the interval [low, high) of its input axis to compute on.

        cells: length of the axis of the canvas. A cut interval starts one output before the first needed output, so
        that the zero padding at the cut affects no needed output.
        """
        strides = [step for first, count in zip(self.spec.strides, self.spec.layers) for step in (first, *[1] * count)]
        if self.training:  # batch norm needs statistics of the whole canvas
            low, size = 0, cells
        sizes = [cells]
        for step in strides[:-1]:
            sizes.append((sizes[-1] - 1) // step + 1)
        spans: list[tuple[int, int]] = []
        ends = {sum(self.spec.layers[: block + 1]) + block: s for block, s in enumerate(self.spec.total_strides)}
        needed = (cells, 0)
        for index in range(len(strides) - 1, -1, -1):
            if (total := ends.get(index)) is not None:
                needed = (min(needed[0], low // total), max(needed[1], (low + size) // total))
            step = strides[index]
            needed = (max(0, step * (needed[0] - 1)), min(sizes[index], step * (needed[1] - 1) + 2))
            spans.append(needed)
        return spans[::-1]


def _cut(features: Tensor, origin: tuple[int, int], lines: tuple[int, int], columns: tuple[int, int]) -> Tensor:
    """Cut the given rows and columns out of a map whose first row and column are `origin`."""
    y, x = origin
    return features[:, :, lines[0] - y : lines[1] - y, columns[0] - x : columns[1] - x]
