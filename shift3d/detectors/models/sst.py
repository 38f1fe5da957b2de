"""SST, the single-stride sparse transformer, for training and inference.

Source: Embracing Single Stride 3D Object Detector with Sparse Transformer (Fan et al. 2022), in its public Waymo
configuration with one frame and only xyz.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID, Pillars
from shift3d.detectors.models.anchor_heads import WAYMO_ANCHORS, AnchorHeads, AnchorSpec
from shift3d.detectors.models.folding import folded_linear, folded_sequence
from shift3d.detectors.models.network import DetectorNet, Precision, precision_dtypes
from shift3d.detectors.models.pillar_net import VoxelEncoder, decorate_with_height
from shift3d.detectors.models.token_windows import Tokens
from shift3d.detectors.models.window_transformer import SST_TRANSFORMER, TransformerSpec, WindowTransformer


@dataclass(frozen=True)
class SstSpec:
    """Sizes of SST. dilations: of the 3x3 convolutions on the dense map; out_channels: input channels of the heads.

    name: name of a network of these sizes in settings and tables.
    """

    transformer: TransformerSpec = SST_TRANSFORMER
    encoder_hidden: int = 64
    dilations: tuple[int, ...] = (1, 1, 2)
    out_channels: int = 384
    name: str = "sst"


SST_SPEC = SstSpec()
SST_SMALL_SPEC = SstSpec(
    transformer=TransformerSpec(width=64, heads=4, feed_forward=128, blocks=3),
    encoder_hidden=32,
    out_channels=192,
    name="sst_small",
)
"""Half the width and blocks of SST: a third of the training step's time, a sixth of the parameters (our choice)."""


def _convolution(in_channels: int, channels: int, size: int, dilation: int = 1) -> list[nn.Module]:
    return [
        nn.Conv2d(in_channels, channels, size, padding=size // 2 * dilation, dilation=dilation, bias=False),
        nn.BatchNorm2d(channels, eps=1e-3, momentum=0.01),
        nn.ReLU(inplace=True),
    ]


class SstNet(DetectorNet):
    """SST: logits, box codes and direction logits of every anchor in the window's core.

    Every pillar is a token. No token is dropped or shuffled, so that the result does not depend on the order of the
    points (the public code shuffles, and drops tokens in training).
    """

    def __init__(self, spec: SstSpec = SST_SPEC, anchors: AnchorSpec = WAYMO_ANCHORS) -> None:
        super().__init__()
        self.name = spec.name
        self.spec = spec
        self.grid = WAYMO_GRID
        self.channels = spec.transformer.width
        width = spec.transformer.width
        self.encoder = VoxelEncoder(spec.encoder_hidden, width)
        self.transformer = WindowTransformer(spec.transformer)
        layers = [module for dilation in spec.dilations for module in _convolution(width, width, 3, dilation)]
        self.dense = nn.Sequential(*layers, *_convolution(width, spec.out_channels, 1))
        self.heads = AnchorHeads(spec.out_channels, anchors)

    def core_span(self, low: int, high: int, cells: int) -> tuple[int, int]:
        """Return [low, high) cut at the grid: any single cell can be a core."""
        return max(0, low), min(cells, high)

    def outer_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        """Return the interval that the core depends on, through the convolutions and each layer's attention windows."""
        low, high = self._dense_span(core_low, core_high, cells)
        low, high = self.transformer.needed_spans(low, high)[0]
        return max(0, low), min(cells, high)

    def _dense_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        reach = sum(self.spec.dilations)
        return max(0, core_low - reach), min(cells, core_high + reach)

    def features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> Tensor:
        """Compute the features (B, out_channels, h, w) of the windows' cores, see `DetectorNet`.

        In a batch, cores smaller than their windows must have the same position in the window.
        """
        pillars, encoded = self.batch_features(clouds, windows, pillars)
        batch = np.repeat(np.arange(len(pillars)), [found.counts.numel() for found in pillars])
        cells = (torch.cat([getattr(found, axis) for found in pillars]).cpu().numpy() for axis in ("cell_x", "cell_y"))
        tokens = Tokens(batch, *cells)
        # Tokens are dropped by their position on the grid, which differs in a batch: only a single scene is cut.
        span_x, span_y = (
            self.core_spans(windows[0]) if len(windows) == 1 else ((0, self.grid.num_x), (0, self.grid.num_y))
        )
        attended, tokens = self.transformer(encoded, tokens, span_x, span_y)
        return self.core_features(attended, tokens, windows)

    def core_features(self, attended: Tensor, tokens: Tokens, windows: Sequence[BevWindow]) -> Tensor:
        """Compute `features` from the transformer's outputs (P, width) for the tokens in the windows' `core_spans`."""
        spans = [self.core_spans(window) for window in windows]
        canvas = self._canvas(attended, tokens, spans)
        weight: Tensor = self.dense[0].weight  # type: ignore[assignment]
        dense = self.dense(canvas.to(weight.dtype))
        window, ((x0, _), (y0, _)) = windows[0], spans[0]
        rows = slice(window.core_y0 - y0, window.core_y0 - y0 + window.core_num_y)
        columns = slice(window.core_x0 - x0, window.core_x0 - x0 + window.core_num_x)
        result: Tensor = dense[:, :, rows, columns]
        return result

    def core_spans(self, window: BevWindow) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the cells (x, y) of the dense map: the core and the cells around it that the convolutions read."""
        x_low, x_high = self._dense_span(window.core_x0, window.core_x0 + window.core_num_x, self.grid.num_x)
        y_low, y_high = self._dense_span(window.core_y0, window.core_y0 + window.core_num_y, self.grid.num_y)
        return (
            (max(window.x0, x_low), min(window.x0 + window.num_x, x_high)),
            (max(window.y0, y_low), min(window.y0 + window.num_y, y_high)),
        )

    def decorated(self, points: Tensor, pillars: Pillars) -> Tensor:
        return decorate_with_height(points, pillars, self.grid)

    def encode(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        features: Tensor = self.encoder(decorated, pillars)
        return features

    def _canvas(self, features: Tensor, tokens: Tokens, spans: list[tuple[tuple[int, int], tuple[int, int]]]) -> Tensor:
        """Scatter features to the dense map (B, C, h, w), channels last in memory, zero in cells without a token."""
        x_low, y_low = (np.asarray([span[axis][0] for span in spans]) for axis in (0, 1))
        width, height = (spans[0][axis][1] - spans[0][axis][0] for axis in (0, 1))
        column, line = tokens.cell_x - x_low[tokens.batch], tokens.cell_y - y_low[tokens.batch]
        inside = (column >= 0) & (column < width) & (line >= 0) & (line < height)
        flat = torch.from_numpy((tokens.batch * height + line) * width + column).to(features.device)
        if not inside.all():
            kept = torch.from_numpy(inside).to(features.device)
            features, flat = features[kept], flat[kept]
        dense = features.new_zeros(len(spans) * height * width, features.shape[1]).index_copy(0, flat, features)
        return dense.view(len(spans), height, width, -1).permute(0, 3, 1, 2)

    def inference(self, precision: Precision) -> SstNet:
        """Return a copy in evaluation mode, batch norms folded in float64, layers in the dtypes of the precision.

        With bfloat16, encoder and the transformer's sums and norms stay in float32: only products use half the bytes.
        """
        exact, dense = precision_dtypes(precision)
        folded = copy.deepcopy(self)
        encoder = folded.encoder
        scale: Tensor = encoder.feature_scale  # type: ignore[assignment]
        encoder.first = folded_linear(encoder.first, encoder.first_norm, scale)
        encoder.second = folded_linear(encoder.second, encoder.second_norm)
        encoder.first_norm = encoder.second_norm = nn.Identity()
        encoder.feature_scale = torch.ones_like(scale)
        folded.dense = folded_sequence(folded.dense)
        folded = folded.eval().requires_grad_(False).to(exact)
        for layer in folded.transformer.modules():
            if isinstance(layer, nn.Linear):
                layer.to(dense)
        folded.dense.to(dense).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        for head in folded.heads.layers:
            head.to(dense)
        return folded
