"""Tensors of a decoder's file, checked before a network is built from them.

A file is not trusted to say how much memory its network takes: shapes are compared first, so that what is allocated
was read from the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import torch
from torch import Tensor, nn

from shift3d.errors import InputError

LARGEST_INPUT = 100.0
"""Of a code's entries and of coordinates in the unit sphere: trained codes stay below 1."""
_LARGEST_VALUE = 1e30
"""Of anything in a network. float32 ends at 3e38, and a sum beyond it is infinite, the difference of two such NaN.
Trained decoders reach at most 1e14 by this estimate."""
_LARGEST_NORMED = 1e18  # a layer norm squares its input


def without_subnormals(weight: Tensor) -> Tensor:
    """The weight (any shape) with values below 1e-20 set to zero.

    Weight norm leaves such values in units that died. They change no sum, but products with them are subnormal
    numbers, and those made a backward pass through the decoder seven times slower (120 ms for 17 ms).
    """
    return torch.where(weight.abs() < 1e-20, torch.zeros_like(weight), weight)


def is_plain(value: Any) -> TypeGuard[Tensor]:
    """Whether a value is a dense tensor of real floating-point numbers in memory: not sparse, integer or complex."""
    return (
        isinstance(value, Tensor)
        and value.layout is torch.strided
        and value.device.type == "cpu"
        and value.is_floating_point()
    )


def described(value: Tensor) -> str:
    """What a tensor is that is not plain, for the error that names it."""
    dtype, layout = (str(word).removeprefix("torch.") for word in (value.dtype, value.layout))
    return f"is {dtype}, {layout}, on {value.device.type}: not dense floating-point numbers"


def checked_tensors(
    tensors: Mapping[str, Any],
    shapes: Mapping[str, tuple[int, ...]],
    where: str,
    named: Mapping[str, str] | None = None,
) -> dict[str, Tensor]:
    """The tensors of a network, float32, finite, without subnormal values.

    Args:
        shapes: of every tensor that there must be. where: the file. named: what the file calls them, where it differs.
    Raises: InputError naming the file and the tensor that is missing, surplus, no dense floating-point tensor, of
        another shape, or not finite in float32.
    """
    called = dict(named or {})
    if surplus := sorted(set(tensors) - set(shapes)):
        what = f"tensor {called.get(surplus[0], surplus[0])} belongs to another network"
        raise InputError(what, where=where, remedy="Give the weights of one network")
    found = {}
    for name, shape in shapes.items():
        value, label = tensors.get(name), called.get(name, name)
        if value is None:
            raise InputError(f"tensor {label} is missing", where, f"Give shape {shape}")
        if tuple(value.shape) != shape:
            raise InputError(f"tensor {label} has shape {tuple(value.shape)}", where, f"Give shape {shape}")
        if not is_plain(value):
            raise InputError(f"tensor {label} {described(value)}", where=where, remedy="Save it as dense float32")
        found[name] = without_subnormals(value.detach().float())
        if not bool(torch.isfinite(found[name]).all()):
            what = f"tensor {label} holds values that are not finite in float32"
            raise InputError(what, where=where, remedy="Copy it again")
    return found


def check_magnitude(
    tensors: Mapping[str, Tensor], entries: Sequence[int], norms: Mapping[int, nn.LayerNorm], where: str
) -> None:
    """Refuse weights with which a value could overflow float32, whatever the code and the point.

    Args:
        tensors: `layers.<i>.weight|bias`. entries: how many inputs each linear layer reads beside the one before it.
        norms: layer norms by the layer that they follow. where: the file.
    Raises: InputError naming the file and the layer, where some value may exceed 1e30 (1e18 before a layer norm) with
        inputs of at most LARGEST_INPUT. An upper bound: |W| h + |b|, layer by layer, in float64.
    """
    hidden = torch.zeros(0, dtype=torch.float64)
    for index, entry in enumerate(entries):
        weight, bias = tensors[f"layers.{index}.weight"], tensors[f"layers.{index}.bias"]
        hidden = torch.cat([hidden, torch.full((entry,), LARGEST_INPUT, dtype=torch.float64)])
        hidden = weight.double().abs() @ hidden + bias.double().abs()
        limit = _LARGEST_NORMED if index in norms else _LARGEST_VALUE
        if not float(hidden.max()) <= limit:  # so that NaN does not pass
            what = f"the weights up to layer {index} are so large that values overflow"
            raise InputError(what, where=where, remedy="Give the weights as trained")
        if index in norms:
            norm = norms[index]
            hidden = norm.weight.double().abs() * len(hidden) ** 0.5 + norm.bias.double().abs()
