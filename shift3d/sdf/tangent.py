"""What a ReLU decoder's value changes by, to first order, when a point or the code moves: for every point by itself.

Autograd gives the derivative of a sum by the code; a rendering wants it for every hit, as the paper's equation for
dz/dx has it. The code enters a folded decoder through two biases alone (see `decoder.Field`), so the derivative by
these, a by-product of the pass back to the point, says everything about it, and costs nothing but its memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.sdf.affine import affine, in_round_batches


@dataclass(frozen=True)
class Tangent:
    """Value and derivatives at N points, sdf frame, in the network's dtype; constants.

    value: (N,) after the tanh. at_point: (N, 3) by the point. at_bias: (N, width) by the bias of each layer asked for.
    """

    value: Tensor
    at_point: Tensor
    at_bias: tuple[Tensor, ...]


@torch.no_grad()
def tangent(
    weights: Sequence[Tensor], biases: Sequence[Tensor], skip_layer: int, x: Tensor, layers: Sequence[int] = ()
) -> Tangent:
    """Evaluate, and go back once.

    Args:
        weights, biases: of the folded decoder, see `decoder.Field`. skip_layer: before which x is fed in again.
        x: (N, 3) points, sdf frame. layers: those by whose bias the derivative is wanted.

    A unit exactly at its switch counts as off, as in autograd. Costs two evaluations.
    Source: our choice: the paper says what is needed, not how it is had.
    """
    count, x = len(x), in_round_batches(x)
    last, hidden, units = len(weights) - 1, x, []
    for layer, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if layer == skip_layer:
            hidden = torch.cat((hidden, x), dim=1)
        hidden = affine(hidden, weight, bias)
        if layer < last:
            hidden = hidden.relu_()
            units.append(hidden)
    value = torch.tanh(hidden[:, 0])
    at_output = (1.0 - value * value)[:, None]
    at_point, at_bias = torch.zeros_like(x), {}
    for layer in range(last, -1, -1):
        if layer < last:
            at_output = torch.ops.aten.threshold_backward(at_output, units[layer], 0.0)  # 0 where the unit is off
        at_bias[layer] = at_output
        at_input = affine(at_output, weights[layer].T, None)
        if layer == skip_layer:
            at_input, at_point = at_input[:, :-3], at_point + at_input[:, -3:]
        at_output = at_input
    by_bias = tuple(at_bias[layer][:count] for layer in layers)
    return Tangent(value[:count], (at_point + at_output)[:count], by_bias)
