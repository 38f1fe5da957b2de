"""Transformer layers over the tokens of each window.

Source: SST (Fan et al. 2022) in its public Waymo configuration: post-norm encoder layers, 8 heads, width 128,
feed-forward 256, GELU; windows of 12 x 12 pillars, shifted by 6 in every second layer; sine position codes of the place
in the window, added to queries and keys.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from shift3d.detectors.models.token_windows import Tokens, WindowGroups, aligned_span, gather_rows, group_by_window
from shift3d.processor import pad_to_bucket


@dataclass(frozen=True)
class TransformerSpec:
    """Sizes of the transformer. blocks: number of layer pairs, one on the lattice and one on the shifted lattice.

    lengths: padded numbers of tokens per window, in addition to the window's area.
    """

    width: int = 128
    heads: int = 8
    feed_forward: int = 256
    blocks: int = 6
    window: int = 12
    lengths: tuple[int, ...] = (30, 60, 100)

    @property
    def shifts(self) -> tuple[int, ...]:
        """Shift of the window lattice per layer, in cells."""
        return (0, self.window // 2) * self.blocks


SST_TRANSFORMER = TransformerSpec()


def position_codes(window: int, width: int) -> Tensor:
    """Compute sine codes of every place in a window: (window * window, width) float32, the first half for x.

    Source: SST's public code: coordinates from the window's middle, temperature 10000.
    """
    quarter = width // 4
    rates = 10000.0 ** (-torch.arange(quarter, dtype=torch.float64) / quarter)
    angle = (torch.arange(window, dtype=torch.float64) - window / 2)[:, None] * rates
    along = torch.stack((angle.sin(), angle.cos()), dim=2).reshape(window, 2 * quarter)
    y, x = torch.meshgrid(torch.arange(window), torch.arange(window), indexing="ij")
    return torch.cat((along[x.reshape(-1)], along[y.reshape(-1)]), dim=1).to(torch.float32)


def _product(layer: nn.Linear, rows: Tensor) -> Tensor:
    """Apply the layer in its dtype, return the dtype of the rows. In bfloat16 rows are padded by `pad_to_bucket`."""
    if layer.weight.dtype != torch.bfloat16 or rows.dtype == torch.bfloat16:
        result: Tensor = layer(rows.to(layer.weight.dtype)).to(rows.dtype)
        return result
    more = pad_to_bucket(len(rows)) - len(rows)
    product: Tensor = layer(functional.pad(rows, (0, 0, 0, more)).bfloat16())
    return product[: len(rows)].to(rows.dtype)


class EncoderLayer(nn.Module):
    """Encoder layer: attention within each window, then a feed-forward network; a norm after each (post-norm)."""

    def __init__(self, spec: TransformerSpec) -> None:
        super().__init__()
        self.heads = spec.heads
        self.query_key = nn.Linear(spec.width, 2 * spec.width)
        self.value = nn.Linear(spec.width, spec.width)
        self.out = nn.Linear(spec.width, spec.width)
        self.widen = nn.Linear(spec.width, spec.feed_forward)
        self.narrow = nn.Linear(spec.feed_forward, spec.width)
        self.norm_attention = nn.LayerNorm(spec.width)
        self.norm_feed_forward = nn.LayerNorm(spec.width)
        for layer in (self.query_key, self.value, self.out, self.widen, self.narrow):
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, tokens: Tensor, positions: Tensor, groups: WindowGroups) -> Tensor:
        """Compute (P, width) from tokens and positions, (P, width) each. Differentiable w.r.t. tokens."""
        attended = self._attention(tokens, positions, groups)
        tokens = self.norm_attention(tokens + _product(self.out, attended))
        hidden = functional.gelu(_product(self.widen, tokens))
        result: Tensor = self.norm_feed_forward(tokens + _product(self.narrow, hidden))
        return result

    def _attention(self, tokens: Tensor, positions: Tensor, groups: WindowGroups) -> Tensor:
        width = tokens.shape[1]
        projected = torch.cat((_product(self.query_key, tokens + positions), _product(self.value, tokens)), dim=1)
        slots = gather_rows(projected, groups.slot_token, groups.token_slot)
        outputs = []
        # split and unbind, not slices: the gradient of each slice would be a tensor of zeros as large as the whole.
        parts = slots.split([bucket.windows * bucket.length for bucket in groups.buckets])
        for bucket, rows in zip(groups.buckets, parts, strict=True):
            split = rows.view(bucket.windows, bucket.length, 3, self.heads, width // self.heads).permute(2, 0, 3, 1, 4)
            query, key, value = split.unbind(0)
            # float32 even for bfloat16 rows: heads of 16 channels are too small to gain, and on the CPU torch's
            # backward pass of bfloat16 attention is eight times slower (2.13: 4.0 against 0.5 s).
            with torch.autocast(rows.device.type, enabled=False):
                attended = functional.scaled_dot_product_attention(query, key, value, bucket.padding)
            outputs.append(attended.transpose(1, 2).reshape(-1, width))
        return gather_rows(torch.cat(outputs), groups.token_slot, groups.slot_token).to(tokens.dtype)


class WindowTransformer(nn.Module):
    """All encoder layers, each on the tokens that the output cells depend on."""

    def __init__(self, spec: TransformerSpec = SST_TRANSFORMER) -> None:
        super().__init__()
        self.spec = spec
        self.layers = nn.ModuleList(EncoderLayer(spec) for _ in spec.shifts)
        self.register_buffer("codes", position_codes(spec.window, spec.width), persistent=False)

    def needed_spans(self, low: int, high: int) -> list[tuple[int, int]]:
        """Return per layer the cells [low, high) of one axis that the final output in [low, high) depends on.

        The span of the first layer is all that the result depends on. Exact: attention reaches exactly its window.
        """
        spans: list[tuple[int, int]] = []
        for shift in reversed(self.spec.shifts):
            low, high = aligned_span(low, high, self.spec.window, shift)
            spans.append((low, high))
        return spans[::-1]

    def layer(self, index: int, features: Tensor, tokens: Tokens, groups: WindowGroups | None = None) -> Tensor:
        """Apply one layer to (P, width) features of whole windows. groups: if computed. Differentiable in features."""
        spec = self.spec
        if groups is None:
            groups = group_by_window(tokens, spec.window, spec.shifts[index], spec.lengths).to(features.device)
        codes: Tensor = self.codes  # type: ignore[assignment]
        positions = codes.to(features.dtype).index_select(0, groups.place)
        result: Tensor = self.layers[index](features, positions, groups)
        return result

    def forward(
        self, features: Tensor, tokens: Tokens, span_x: tuple[int, int], span_y: tuple[int, int]
    ) -> tuple[Tensor, Tokens]:
        """Apply all layers to features (P, width). Return features and tokens in the cells of the spans.

        span_x, span_y: output cells [low, high). Tokens are dropped once no later layer needs them, which does not
        change the result (our choice: the public code computes all tokens). Differentiable w.r.t. features.
        """
        spec = self.spec
        needed = zip(self.needed_spans(*span_x), self.needed_spans(*span_y), strict=True)
        groups: dict[int, WindowGroups] = {}
        for index, (shift, (cells_x, cells_y)) in enumerate(zip(spec.shifts, needed, strict=True)):
            features, tokens, dropped = _within(features, tokens, cells_x, cells_y)
            if dropped:
                groups = {}
            if shift not in groups:
                groups[shift] = group_by_window(tokens, spec.window, shift, spec.lengths).to(features.device)
            if len(tokens.batch):
                features = self.layer(index, features, tokens, groups[shift])
        features, tokens, _ = _within(features, tokens, span_x, span_y)
        return features, tokens


def _within(
    features: Tensor, tokens: Tokens, cells_x: tuple[int, int], cells_y: tuple[int, int]
) -> tuple[Tensor, Tokens, bool]:
    """Return features and tokens inside the cells, and True if any token was outside."""
    inside = (
        (tokens.cell_x >= cells_x[0]) & (tokens.cell_x < cells_x[1])
        & (tokens.cell_y >= cells_y[0]) & (tokens.cell_y < cells_y[1])
    )  # fmt: skip
    if inside.all():
        return features, tokens, False
    kept = torch.from_numpy(inside.nonzero()[0]).to(features.device)
    back = torch.full((len(inside),), kept.numel(), dtype=torch.int64, device=features.device)
    back[kept] = torch.arange(kept.numel(), device=features.device)
    return gather_rows(features, kept, back), tokens.take(inside), True
