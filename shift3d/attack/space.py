"""Spaces of shape searches: every code, a subspace of codes within a ball, or a generator's parameters in a box."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.attack.baselines import random_code
from shift3d.errors import InputError
from shift3d.sdf.principal_components import ball_radius, principal_components
from shift3d.vehicles.parameter_box import ParameterBox


@dataclass(frozen=True)
class CodeSpace:
    """Codes that a shape search may visit: z = code(u) for coordinates u (k,) that `project` does not change.

    start: coordinates of the baseline's code. draw: (generator, latent distance) -> random coordinates; see
    `Search.draw`.
    """

    start: Tensor
    code: Callable[[Tensor], Tensor]
    project: Callable[[Tensor], Tensor]
    draw: Callable[[np.random.Generator, float], Tensor]


def free_space(code0: Tensor) -> CodeSpace:
    """Return the space of every code, as in the paper; the coordinates are the code itself."""

    def draw(rng: np.random.Generator, distance: float) -> Tensor:
        return random_code(code0, distance, rng)

    return CodeSpace(code0, lambda code: code, lambda code: code, draw)


def _linear(code0: Tensor, start: Tensor, basis: Tensor) -> Callable[[Tensor], Tensor]:
    """Return the map from coordinates (k,) to codes: z0 at `start`, linear in the difference by basis (k, d)."""
    return lambda u: (code0.detach().double() + (u - start) @ basis).to(code0.dtype)


NEIGHBOUR_SIGMA = 0.5
"""Standard deviation of draws around a known code, in units of all known codes' (our choice: a similar vehicle)."""


def pca_space(code0: Tensor, codes: NDArray[np.float32], components: int, where: str, near: bool = False) -> CodeSpace:
    """Return the plane through the baseline's code along principal components of known codes, within an ellipsoid.

    Coordinates are standard deviations of the known codes along each component, relative to their mean. The length of
    the coordinates is at most that of 95 % of a Gaussian's draws, or the baseline's own if that is longer. The part of
    the baseline's code outside the components stays unchanged.

    Args: code0: (d,). codes: (N, d) known codes. components: k. where: owner of the codes, for messages. near: draws
    are the baseline's code moved by `NEIGHBOUR_SIGMA` along each component; False: draws of that Gaussian.
    Raises: InputError for fewer than k + 2 codes, or codes that do not spread along k components.
    Source: SHIFT3D's supplement takes 10 principal components to reconstruct vehicles; the ellipsoid is our choice.
    """
    mean, spread, axes = principal_components(codes, components, where, "attack.components")
    basis = torch.from_numpy(spread[:, None] * axes)
    start = torch.from_numpy(((code0.detach().double().numpy() - mean) @ axes.T) / spread)
    radius = max(ball_radius(components), float(start.norm()))

    def project(u: Tensor) -> Tensor:
        length = float(u.norm())
        return u * (radius / length) if length > radius else u

    def draw(rng: np.random.Generator, distance: float) -> Tensor:
        drawn = torch.from_numpy(rng.standard_normal(components))
        return project(start + NEIGHBOUR_SIGMA * drawn if near else drawn)

    return CodeSpace(start, _linear(code0, start, basis), project, draw)


def parameter_space(code0: Tensor, box: ParameterBox) -> CodeSpace:
    """Return the space of a vehicle's own kind: its parameters within the ranges of that kind.

    Coordinates run from -1 to 1 over each range. Source: our choice.
    """
    middle, half = torch.from_numpy((box.low + box.high) / 2), torch.from_numpy((box.high - box.low) / 2)
    basis = half[:, None] * torch.from_numpy(box.basis.astype(np.float64))
    start = (torch.from_numpy(box.start) - middle) / half

    def draw(rng: np.random.Generator, distance: float) -> Tensor:
        return torch.from_numpy(rng.uniform(-1.0, 1.0, len(start)))

    return CodeSpace(start, _linear(code0, start, basis), lambda u: u.clamp(-1.0, 1.0), draw)


def edited_code(code0: Tensor, box: ParameterBox, edit: str, where: str) -> Tensor:
    """Compute a vehicle's code (d,) with one parameter set to another place in the range of the vehicle's kind.

    edit: "NAME:PLACE", PLACE from -1 (the lowest of the kind) to 1. where: owner of the code, for messages.
    Raises: InputError for a parameter that is not free in the kind, or a place outside its range.
    """
    name, _, text = edit.rpartition(":")
    if name not in box.names:
        raise InputError(f"no parameter {name or text!r}", where, f"Give NAME:PLACE; names are: {', '.join(box.names)}")
    try:
        place = float(text)
    except ValueError:
        place = math.nan
    if not -1.0 <= place <= 1.0:
        raise InputError(f"{text!r} is no place in the range of {name}", where, "Give NAME:PLACE, PLACE from -1 to 1")
    space = parameter_space(code0, box)
    u = space.start.clone()
    u[box.names.index(name)] = place
    return space.code(u)
