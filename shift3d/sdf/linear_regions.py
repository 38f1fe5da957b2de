"""Linear regions of a ReLU decoder along a line, one region at a time, in closed form.

On a line x(k) = x + k d every pre-activation is linear in k until the first unit switches. Value and slope at one place
therefore describe the whole region, the region's end is known, and a root in the region is a quotient. Traversal from
region to region finds the FIRST root of a beam, without a step size that could be too long.

Source: Sotoudeh & Thakur 2019 (exact linear restrictions of networks) for the observation. Traversal region by region
from the sensor, instead of layer by layer over the whole line, is our choice: only the part before the first root is
needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.sdf.affine import affine


@dataclass(frozen=True)
class LinearRegion:
    """Values on N lines until the next unit switches; (N,) each, in the network's dtype.

    value: pre-tanh output at the start; it has the sign and the zeros of g. slope: derivative of the output by the
    line's parameter. length: of the region, in units of the parameter; infinite if no further unit switches.
    """

    value: Tensor
    slope: Tensor
    length: Tensor


def linear_region(
    weights: Sequence[Tensor], biases: Sequence[Tensor], skip_layer: int, x: Tensor, direction: Tensor
) -> LinearRegion:
    """Compute the linear regions at the starts of N lines.

    Args:
        weights, biases: of the folded decoder, see `decoder.Field`. skip_layer: layer that reads x again.
        x: (N, 3) starts, sdf frame. direction: (N, 3) d x / d k, sdf units per unit of the parameter k >= 0.

    A unit exactly at its switch belongs to the region ahead. Costs two evaluations. Not differentiable.
    """
    count, last = len(x), len(weights) - 1
    hidden = entry = torch.cat((x, direction))  # values above, derivatives below: one product serves both
    length = torch.full((count,), torch.inf, dtype=x.dtype)
    for layer, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if layer == skip_layer:
            hidden = torch.cat((hidden, entry), dim=1)
        hidden = affine(hidden, weight, None)
        value, slope = hidden[:count].add_(bias), hidden[count:]
        if layer == last:
            return LinearRegion(value[:, 0], slope[:, 0], length)
        until = torch.where(value * slope < 0, -value / slope, torch.inf)
        length = torch.minimum(length, until.amin(1))
        active = (value > 0) | ((value == 0) & (slope > 0))
        hidden = hidden * torch.cat((active, active))
    raise AssertionError("a decoder has at least one layer")
