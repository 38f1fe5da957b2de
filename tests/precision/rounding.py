"""Bounds of the effect of float32 on a result, from its operations and one run in float64.

u = 2^-24 is the largest relative error of one rounding. A sum of n products computed in any order is off by at most n u
|a| |b| (Higham 2002, section 3.1), where |a| |b| is the sum of the products' sizes. Because rounding errors have either
sign, it is off by no more than lambda sqrt(n) u |a| |b| except with probability 2 n exp(-lambda^2 / 2) (Higham & Mary
2019, theorem 2.4): one in sixty thousand with `LAMBDA` 6 and n 512. An error inside a network reaches its output times
the derivative there, to first order. Errors of different places are independent, so that they add up in quadrature.

No constant is fitted to observed float32 errors. Tests also assert that the bound is not vacuous: the observed error
exceeds `EMPTY` of it, which a kernel that silently runs in float64 would not reach.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn
from torch.nn import functional

from shift3d.sdf.field import Field

U32 = 2.0**-24
LAMBDA = 6.0
EMPTY = 1e-4


def gamma(count: int) -> float:
    """Return the worst relative error of `count` float32 operations in a row, to first order."""
    return count * U32 / (1 - count * U32)


def input_rounding(field: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Bound (N,) the change of g by rounding coordinates x (N, 3) float64 to float32: sum_i |dg/dx_i| u |x_i|."""
    leaf = x.detach().clone().requires_grad_()
    (gradient,) = torch.autograd.grad(field(leaf).sum(), leaf)
    return (gradient.abs() * U32 * leaf.detach().abs()).sum(-1)


def decoder_rounding(field: Field, x: Tensor, code: Tensor) -> Tensor:
    """Bound (N,) the change of g by the decoder's sums in float32, sdf units.

    field: in float64. x: (N, 3) float64 places. code: code of the field. Its products with the first and the skip layer
    are sums of len(code) + 1 terms, in the biases; their terms are no larger than |bias| sqrt(len(code)).
    """
    hidden, switched, sizes = x, [], []
    for layer, (weight, bias) in enumerate(zip(field.weights, field.biases)):
        if layer == field.skip_layer:
            hidden = torch.cat((hidden, x), 1)
        sizes.append(hidden.abs() @ weight.abs().T + bias.abs())
        hidden = hidden @ weight.T + bias
        switched.append(hidden > 0)
        hidden = torch.relu(hidden)
    # Backward from the output: the derivative of the output by each pre-activation.
    derivative, total = torch.ones(len(x), 1, dtype=x.dtype), torch.zeros(len(x), dtype=x.dtype)
    for layer in reversed(range(len(field.weights))):
        if layer < len(field.weights) - 1:
            derivative = derivative * switched[layer]
        weight, bias = field.weights[layer], field.biases[layer]
        total += (derivative * math.sqrt(weight.shape[1] + 1) * U32 * sizes[layer]).square().sum(-1)
        if layer in (0, field.skip_layer):
            total += (derivative * (len(code) + 1) * U32 * bias.abs()).square().sum(-1)
        derivative = derivative @ weight
        if layer == field.skip_layer:
            derivative = derivative[:, :-3]
    return LAMBDA * total.sqrt() + 4 * U32 * field(x).abs()  # and tanh: accurate to a few units in the last place


class RunningError:
    """Rounding error of a network in float32, computed while it runs in float64.

    The output of each layer gets an added zero, by which the network's output is then differentiated: this derivative
    times the layer's own rounding error is the error that reaches the output.
    """

    def __init__(self) -> None:
        self._errors: list[tuple[Tensor, Tensor]] = []
        self._weights: list[Tensor] = []

    @contextmanager
    def watch(self, net: nn.Module) -> Iterator[RunningError]:
        """Record the calls of `net` (float64) within this context."""
        hooks = []
        self._weights = [weight.requires_grad_() for weight in net.parameters()]
        for module in net.modules():
            if isinstance(module, nn.Linear | nn.Conv2d | nn.ConvTranspose2d):
                hooks.append(module.register_forward_hook(self._sum))
            elif isinstance(module, nn.LayerNorm):
                hooks.append(module.register_forward_hook(self._norm))
        yield self
        for hook in hooks:
            hook.remove()
        net.requires_grad_(False)

    def add(self, value: Tensor, size: Tensor, count: float) -> Tensor:
        """Record that `value` was made by sums of `count` terms of `size`. Returns the value to use in its place."""
        zero = torch.zeros_like(value, requires_grad=True)
        self._errors.append((zero, math.sqrt(count) * size.detach()))
        return value + zero

    def bound(self, output: Tensor) -> float:
        """Bound the change of a scalar output by float32."""
        leaves = [zero for zero, _ in self._errors] + self._weights
        derivatives = torch.autograd.grad(output, leaves, retain_graph=True, allow_unused=True)
        # Folded weights are rounded to float32 once: one error per weight, wherever it is used.
        sizes = [size for _, size in self._errors] + [weight.detach().abs() for weight in self._weights]
        parts = [(d * size).square().sum() for d, size in zip(derivatives, sizes) if d is not None]
        return LAMBDA * U32 * math.sqrt(float(torch.stack(parts).sum()))

    def _sum(self, module: nn.Module, inputs: tuple[Tensor], output: Tensor) -> Tensor:
        sizes = copy.deepcopy(module)
        with torch.no_grad():
            for parameter in sizes.parameters():
                parameter.abs_()
            sizes._forward_hooks.clear()
            weight = sizes.weight
            assert isinstance(weight, Tensor)
            return_size = sizes(inputs[0].detach().abs())
        return self.add(output, return_size, weight[0].numel() + 1)

    def _norm(self, module: nn.Module, inputs: tuple[Tensor], output: Tensor) -> Tensor:
        """Record a layer norm: mean and variance are sums over channels; their errors are divided by the deviation."""
        assert isinstance(module, nn.LayerNorm)
        x = inputs[0].detach()
        deviation = (x.var(-1, unbiased=False, keepdim=True) + module.eps).sqrt()
        size = module.weight.detach().abs() * (x.abs() + x.abs().mean(-1, keepdim=True)) / deviation
        return self.add(output, size + module.bias.detach().abs(), x.shape[-1])


@contextmanager
def attention_watched(error: RunningError, longest: int) -> Iterator[None]:
    """Record the rounding of attention over at most `longest` tokens.

    A weight is exp of a product of two vectors: its error is its own size times the product's error, in numerator and
    denominator. Weights are positive and add to 1, so that no output is larger than the largest value.
    """
    original = functional.scaled_dot_product_attention

    def watched(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None = None) -> Tensor:
        result = original(query, key, value, mask)
        width = query.shape[-1]
        product = query.detach().norm(dim=-1).amax() * key.detach().norm(dim=-1).amax() / math.sqrt(width)
        size = value.detach().abs().amax(-2, keepdim=True).expand_as(result) * (1.0 + 2.0 * product)
        return error.add(result, size, longest + width)

    functional.scaled_dot_product_attention = watched
    try:
        yield
    finally:
        functional.scaled_dot_product_attention = original
