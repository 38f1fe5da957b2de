"""The products that a decoder is made of, where no gradient is wanted: x W^T + b by the library that is fast here."""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.processor import has_fast_bfloat16, has_wide_float32, pad_to_bucket


def affine(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Rows x (N, in) times weight (out, in) transposed, plus bias (out,): (N, out).

    float32 on CPU goes to oneDNN where that is the faster (`processor`), anything else, and whatever gradients are
    asked of, to torch. The two differ by roundings; either gives a row the same value whatever rows stand beside it,
    but for MKL with less than a handful of them. Differentiable.
    """
    plain = x.dtype == torch.float32 and x.device.type == "cpu" and type(x) is Tensor
    if plain and has_wide_float32() and not _is_differentiated(x, weight, bias):
        # Its own ReLU would turn NaN into 0: activations are left to torch.
        result: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")
        return result
    return x @ weight.T if bias is None else torch.addmm(bias, x, weight.T)


def padded_to_bucket(x: Tensor, *parts: Tensor) -> Tensor:
    """Points x (N, 3) with rows of zeros behind them, up to a number that comes round again: see `pad_to_bucket`.

    The same tensor where oneDNN is not asked, or a gradient of the point or the parts is wanted.
    """
    supported = (x.dtype == torch.bfloat16 and has_fast_bfloat16()) or (x.dtype == torch.float32 and has_wide_float32())
    if not supported or x.device.type != "cpu" or type(x) is not Tensor or _is_differentiated(x, *parts):
        return x
    return torch.nn.functional.pad(x, (0, 0, 0, pad_to_bucket(len(x)) - len(x)))


def _is_differentiated(*parts: Tensor | None) -> bool:
    return torch.is_grad_enabled() and any(part is not None and part.requires_grad for part in parts)
