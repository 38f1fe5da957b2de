"""Field of one latent code: the decoder's weights folded for the code, optionally sliced to the active units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from shift3d.processor import has_fast_bfloat16
from shift3d.sdf.affine import active_units, affine, padded_to_bucket
from shift3d.sdf.bfloat16 import Bfloat16Field
from shift3d.sdf.linear_regions import LinearRegion, linear_region


@dataclass(frozen=True)
class FieldGradient:
    """Constant value and derivatives of a field at N points, sdf frame, in the network's dtype.

    value: (N,) after the tanh. at_point: (N, 3) by the point. at_bias: (N, width) by the bias of each requested layer.
    """

    value: Tensor
    at_point: Tensor
    at_bias: tuple[Tensor, ...]


class Field:
    """g(z, .) of one latent code with folded weights; all terms that depend on z alone are computed once.

    Differentiable w.r.t. the points and, through the two biases, w.r.t. z. The dtype is that of the decoder.
    """

    def __init__(self, weights: list[Tensor], biases: list[Tensor], skip_layer: int) -> None:
        self.weights, self.biases, self.skip_layer = weights, biases, skip_layer
        self._last_slice: tuple[Sequence[Tensor], Field] | None = None

    @property
    def dtype(self) -> torch.dtype:
        """Dtype to which points are cast."""
        return self.weights[0].dtype

    @cached_property
    def rough(self) -> Bfloat16Field | None:
        """The field in bfloat16; None if bfloat16 is slow on this CPU, in float64, or without a `Decoder`'s layout."""
        if self.dtype != torch.float32 or self.skip_layer < 1 or not has_fast_bfloat16():
            return None
        return Bfloat16Field(self.weights, self.biases, self.skip_layer)

    def __call__(self, x_sdf: Tensor) -> Tensor:
        """Compute signed distances (N,), sdf units, negative inside, in (-1, 1) because of the tanh.

        x_sdf: points (N, 3), sdf frame, unit-sphere units; cast to the field's dtype.
        """
        return self._evaluate(x_sdf)

    def survey(self, x_sdf: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Compute values (N,) at points (N, 3), sdf frame, and a bool mask per layer of the units active at any point.

        Not differentiable.
        """
        live: list[Tensor] = []
        with torch.no_grad():
            return self._evaluate(x_sdf, live), live

    def _evaluate(self, x_sdf: Tensor, live: list[Tensor] | None = None) -> Tensor:
        """Compute values (N,). `live` receives the masks of `survey`; gradients must then be off."""
        x = padded_to_bucket(x_sdf.to(self.dtype), *self.weights, *self.biases)
        for layer, output in enumerate(self._outputs(x), 1):
            if live is not None and layer < len(self.weights):
                live.append(active_units(output[: len(x_sdf)]))
        return torch.tanh(output[: len(x_sdf), 0])

    def _outputs(self, x: Tensor) -> Iterator[Tensor]:
        """Yield the output of each layer at points (N, 3): hidden units after the ReLU, at last the value (N, 1)."""
        hidden = x
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if layer == self.skip_layer:
                hidden = torch.cat([hidden, x], dim=1)
            hidden = affine(hidden, weight, bias)
            if layer < len(self.weights) - 1:
                hidden = hidden.relu_()
            yield hidden

    def region(self, x_sdf: Tensor, direction: Tensor) -> LinearRegion:
        """Return the `LinearRegion` at the starts of lines (N, 3) + k (N, 3), sdf frame. Not differentiable."""
        with torch.no_grad():
            return linear_region(
                self.weights, self.biases, self.skip_layer, x_sdf.to(self.dtype), direction.to(self.dtype)
            )

    @property
    def code_layers(self) -> tuple[int, ...]:
        """Layers whose bias depends on a code that requires gradients; empty without such a code."""
        return tuple(layer for layer, bias in enumerate(self.biases) if bias.requires_grad)

    @torch.no_grad()
    def tangent(self, x_sdf: Tensor, layers: Sequence[int] = ()) -> FieldGradient:
        """Compute values and derivatives at points (N, 3), sdf frame, and by some layers' biases, in one backward pass.

        A unit exactly at its switch counts as off, as in autograd. Costs two evaluations.
        Source: our choice: the paper states the quantity, not its computation.
        """
        count, x, last = len(x_sdf), padded_to_bucket(x_sdf.to(self.dtype)), len(self.weights) - 1
        *units, output = self._outputs(x)
        value = torch.tanh(output[:, 0])
        at_output = (1.0 - value * value)[:, None]
        at_point, at_bias = torch.zeros_like(x), {}
        for layer in range(last, -1, -1):
            if layer < last:
                at_output = torch.ops.aten.threshold_backward(at_output, units[layer], 0.0)  # 0 where the unit is off
            at_bias[layer] = at_output
            at_input = affine(at_output, self.weights[layer].T, None)
            if layer == self.skip_layer:
                at_input, at_point = at_input[:, :-3], at_point + at_input[:, -3:]
            at_output = at_input
        by_bias = tuple(at_bias[layer][:count] for layer in layers)
        return FieldGradient(value[:count], (at_point + at_output)[:count], by_bias)

    def sliced(self, live: Sequence[Tensor]) -> Field:
        """Return the field without inactive hidden units: same values wherever only `live` units are active.

        Layers whose bias depends on the code stay whole, so that derivatives by these biases keep their width.
        Renderings request the same units repeatedly, so the last slice is cached.
        """
        if self._last_slice is None or not all(map(torch.equal, live, self._last_slice[0])):
            self._last_slice = live, self._sliced(live)
        return self._last_slice[1]

    def _sliced(self, live: Sequence[Tensor]) -> Field:
        rows: list[Tensor | None] = []
        for layer, mask in enumerate(live):
            whole = layer in (0, self.skip_layer)
            rows.append(None if whole or bool(mask.all()) else _round_units(mask))
        weights, biases, before = [], [], None
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if before is not None:
                if layer == self.skip_layer:
                    width = weight.shape[1]
                    before = torch.cat((before, torch.arange(width - 3, width)))
                weight = weight.index_select(1, before)
            before = rows[layer] if layer < len(live) else None
            if before is not None:
                weight, bias = weight.index_select(0, before), bias.index_select(0, before)
            weights.append(weight.contiguous())
            biases.append(bias)
        return Field(weights, biases, self.skip_layer)

    def detach(self) -> Field:
        """Return the same field without the graph back to z."""
        return Field([w.detach() for w in self.weights], [b.detach() for b in self.biases], self.skip_layer)


_UNITS = 32  # libraries compile code for every matrix size, so the number of sizes is kept small: see `pad_to_bucket`


def _round_units(live: Tensor) -> Tensor:
    """Return (n,) ascending indices: the active units, filled up with others until n is a multiple of `_UNITS`."""
    on, off = torch.nonzero(live).squeeze(1), torch.nonzero(~live).squeeze(1)
    missing = min(-len(on) % _UNITS, len(off))
    return torch.cat((on, off[:missing])).sort().values
