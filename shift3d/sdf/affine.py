"""The products that a decoder is made of, where no gradient is wanted: x W^T + b by the library that is fast here."""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.processor import has_fast_bfloat16, has_wide_float32, pad_to_bucket

_LEAST_ROWS = 16


def affine(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Rows x (N, in) times weight (out, in) transposed, plus bias (out,): (N, out).

    float32 on CPU goes to oneDNN where that is the faster (`processor`); anything else, and what gradients are wanted
    of, to torch. They differ by roundings. Without gradients either gives a row the same value whatever rows stand
    beside it, MKL from 16 rows on: see `padded_to_bucket`. Differentiable.
    """
    plain = x.dtype == torch.float32 and x.device.type == "cpu" and type(x) is Tensor
    if plain and not _is_differentiated(x, weight, bias):
        if has_wide_float32():
            # Its own ReLU would turn NaN into 0: activations are left to torch.
            result: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")
            return result
        if len(weight) == 1:  # MKL adds up a single column in an order that depends on the number of rows
            column = (x * weight).sum(1, keepdim=True)
            return column if bias is None else column + bias
    return x @ weight.T if bias is None else torch.addmm(bias, x, weight.T)


def padded_to_bucket(x: Tensor, *parts: Tensor) -> Tensor:
    """Points x (N, 3) with rows of zeros behind them: so many that no value depends on how many points there are.

    For oneDNN up to a number that comes round again, see `pad_to_bucket`; for MKL up to 16. The same tensor in float64,
    without points, and where a gradient of the point or the parts is wanted.
    """
    narrow = x.dtype == torch.float32 or (x.dtype == torch.bfloat16 and has_fast_bfloat16())
    if not narrow or x.device.type != "cpu" or type(x) is not Tensor or _is_differentiated(x, *parts):
        return x
    rows = len(x)
    onednn = x.dtype == torch.bfloat16 or has_wide_float32()
    wanted = pad_to_bucket(rows) if onednn or not rows else max(rows, _LEAST_ROWS)
    return torch.nn.functional.pad(x, (0, 0, 0, wanted - rows))


def units_on(hidden: Tensor) -> Tensor:
    """(width,) bool: which units are on in one of the rows (N, width) behind a rectifier. A NaN is on."""
    return hidden.amax(0) != 0 if len(hidden) else hidden.new_zeros(hidden.shape[1], dtype=torch.bool)


def _is_differentiated(*parts: Tensor | None) -> bool:
    return torch.is_grad_enabled() and any(part is not None and part.requires_grad for part in parts)
