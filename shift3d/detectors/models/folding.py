"""Folding of batch norms into the preceding layer: the same function with fewer operations."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn


def _scale_and_shift(norm: nn.Module) -> tuple[Tensor, Tensor]:
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d)
    assert norm.running_mean is not None and norm.running_var is not None
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    return scale, norm.bias.double() - norm.running_mean.double() * scale


def folded_linear(layer: nn.Linear, norm: nn.Module, input_gains: Tensor | None = None) -> nn.Linear:
    """Fold a linear layer without bias, the norm after it in evaluation mode and input gains (in_features,) into one.

    Folded in float64; the result has the dtype of the layer.
    """
    scale, shift = _scale_and_shift(norm)
    folded = nn.Linear(layer.in_features, layer.out_features)
    weight = layer.weight.double() * scale[:, None]
    if input_gains is not None:
        weight = weight * input_gains.double()
    folded.weight = nn.Parameter(weight.to(layer.weight.dtype))
    folded.bias = nn.Parameter(shift.to(layer.weight.dtype))
    return folded


def _folded_convolution(layer: nn.Module, norm: nn.Module) -> nn.Module:
    scale, shift = _scale_and_shift(norm)
    folded = copy.deepcopy(layer)
    assert isinstance(folded, nn.Conv2d | nn.ConvTranspose2d)
    shape = (1, -1, 1, 1) if isinstance(folded, nn.ConvTranspose2d) else (-1, 1, 1, 1)
    dtype = folded.weight.dtype
    folded.weight = nn.Parameter((folded.weight.double() * scale.view(shape)).to(dtype))
    if layer.bias is not None:
        shift = shift + layer.bias.double() * scale  # type: ignore[operator]
    folded.bias = nn.Parameter(shift.to(dtype))
    return folded


def folded_sequence(sequence: nn.Sequential) -> nn.Sequential:
    """Fold each norm, in evaluation mode, into the convolution before it. Folded in float64."""
    modules: list[nn.Module] = []
    for module in sequence:
        if isinstance(module, nn.BatchNorm2d):
            modules[-1] = _folded_convolution(modules[-1], module)
        else:
            modules.append(module)
    return nn.Sequential(*modules)
