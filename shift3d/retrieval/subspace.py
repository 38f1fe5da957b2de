"""Decoder restricted to the principal components of its codes; the coordinates change only two of its biases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.errors import InputError
from shift3d.sdf.field import Field
from shift3d.sdf.principal_components import ball_radius, principal_components
from shift3d.seeding import generator

if TYPE_CHECKING:
    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

COMPONENTS = 10
_CODES, _PLACES = 24, 512


@dataclass(frozen=True)
class Subspace:
    """Codes z = mean + u @ basis, u (k,) in standard deviations of the known codes, within a ball of `radius`.

    mean: (d,) float64. basis: (k, d) float64. field_at_mean: float32. by_coordinate: (width, k) float32 for each layer
    that reads the code, the derivative of its bias w.r.t. u.
    """

    mean: NDArray[np.float64]
    basis: NDArray[np.float64]
    radius: float
    field_at_mean: Field
    by_coordinate: dict[int, Tensor]

    @staticmethod
    def of(
        decoder: Decoder | DeepSdfNetwork,
        codes: NDArray[np.float32],
        components: int = COMPONENTS,
        where: str = "codes",
    ) -> Subspace:
        """Build the subspace of codes (N, d) that a float32 decoder is known to draw.

        Hidden units that are off at 512 places of the unit ball, for the mean and for other codes of the ellipsoid, are
        removed: evaluation takes half the time, and values change by less than 0.1 mm on a car.

        Raises: InputError as `principal_components`, and for a decoder whose code enters other than by biases.
        Source: SHIFT3D, supplement, takes 10 components; the ellipsoid is our choice.
        """
        mean, spread, axes = principal_components(codes, components, where)
        basis = spread[:, None] * axes
        centre = decoder.field(torch.from_numpy(mean).float())
        if not isinstance(centre, Field):
            what = "a decoder with layer norm, a second tanh, layers of unequal width or several skips is not supported"
            raise InputError(what, where, "Give vehicles of another decoder")
        centre = centre.detach()
        steps = [decoder.field(torch.from_numpy(mean + row).float()) for row in basis]
        by_coordinate = {}
        for layer in (0, centre.skip_layer):
            columns = [step.biases[layer].detach() - centre.biases[layer] for step in steps if isinstance(step, Field)]
            by_coordinate[layer] = torch.stack(columns, dim=1)
        radius = ball_radius(components)
        whole = Subspace(mean, basis, radius, centre, by_coordinate)
        return Subspace(mean, basis, radius, centre.sliced(whole._active_unit_masks()), by_coordinate)

    @property
    def components(self) -> int:
        """Number of components k."""
        return len(self.basis)

    def code(self, u: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the latent code (d,) of coordinates (k,)."""
        return (self.mean + u @ self.basis).astype(np.float32)

    def project(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project coordinates (k,) beyond the ellipsoid onto its surface."""
        length = float(np.linalg.norm(u))
        return u * (self.radius / length) if length > self.radius else u

    def field(self, u: NDArray[np.float64]) -> Field:
        """Return the field of coordinates (k,), without gradients."""
        at, biases = torch.from_numpy(u).float(), list(self.field_at_mean.biases)
        for layer, columns in self.by_coordinate.items():
            biases[layer] = biases[layer] + columns @ at
        return Field(self.field_at_mean.weights, biases, self.field_at_mean.skip_layer)

    def linearized(self, u: NDArray[np.float64], x_sdf: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return values (N,) at points (N, 3), sdf frame, and derivatives by the point (N, 3) and by u (N, k).

        Costs two evaluations, see `sdf.field`.
        """
        layers = tuple(self.by_coordinate)
        found = self.field(u).tangent(x_sdf, layers)
        by_u = sum(at @ self.by_coordinate[layer] for layer, at in zip(layers, found.at_bias))
        assert isinstance(by_u, Tensor)
        return found.value, found.at_point, by_u

    def _active_unit_masks(self) -> list[Tensor]:
        """Return a mask per layer of hidden units that are on at some place of the unit ball for some code."""
        rng = generator("subspace survey", self.components)
        places = torch.from_numpy(rng.standard_normal((_PLACES, 3))).float()
        radius = torch.from_numpy(np.cbrt(rng.uniform(size=(_PLACES, 1)))).float()
        places = torch.nn.functional.normalize(places, dim=1) * radius
        drawn = [np.zeros(self.components), *map(self.project, rng.standard_normal((_CODES, self.components)))]
        masks = [self.field(u).survey(places)[1] for u in drawn]
        return [torch.stack(layer).any(0) for layer in zip(*masks)]
