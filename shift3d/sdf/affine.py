"""Affine products x W^T + b of a decoder, computed without gradients by the library that is fastest on this machine."""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.processor import has_fast_bfloat16, onednn_float32_is_faster, pad_to_bucket

_LEAST_ROWS = 16


def affine(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Multiply rows x (N, in) by weight (out, in) transposed and add bias (out,). Returns (N, out).

    float32 on CPU without gradients uses oneDNN if that is faster (`processor`); everything else uses torch. Results
    differ by rounding. Without gradients a row's value does not depend on the other rows, with MKL from 16 rows on: see
    `padded_to_bucket`. Differentiable.
    """
    plain = x.dtype == torch.float32 and x.device.type == "cpu" and type(x) is Tensor
    if plain and not _is_differentiated(x, weight, bias):
        if onednn_float32_is_faster():
            # oneDNN's fused ReLU would turn NaN into 0, so torch applies the activations.
            result: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")
            return result
        if len(weight) == 1:  # MKL sums a single column in an order that depends on the number of rows
            column = (x * weight).sum(1, keepdim=True)
            return column if bias is None else column + bias
    return x @ weight.T if bias is None else torch.addmm(bias, x, weight.T)


def padded_to_bucket(x: Tensor, *parts: Tensor) -> Tensor:
    """Append rows of zeros to points x (N, 3) so that no value depends on the number of points.

    The number of rows is a bucket size for oneDNN (`pad_to_bucket`), and at least 16 for MKL. float64 tensors, empty
    tensors, tensors off the CPU, and tensors with gradients of x or the parts are returned as they are.
    """
    narrow = x.dtype == torch.float32 or (x.dtype == torch.bfloat16 and has_fast_bfloat16())
    if not narrow or x.device.type != "cpu" or type(x) is not Tensor or _is_differentiated(x, *parts):
        return x
    rows = len(x)
    onednn = x.dtype == torch.bfloat16 or onednn_float32_is_faster()
    wanted = pad_to_bucket(rows) if onednn or not rows else max(rows, _LEAST_ROWS)
    return torch.nn.functional.pad(x, (0, 0, 0, wanted - rows))


def active_units(hidden: Tensor) -> Tensor:
    """Mask (width,) of the units that are nonzero in any of the rows (N, width) after a ReLU. A NaN is active."""
    return hidden.amax(0) != 0 if len(hidden) else hidden.new_zeros(hidden.shape[1], dtype=torch.bool)


def _is_differentiated(*parts: Tensor | None) -> bool:
    return torch.is_grad_enabled() and any(part is not None and part.requires_grad for part in parts)
