"""Surface extraction for a latent code in 0.2 seconds: coarse to fine, evaluated near the surface only."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import trimesh
from torch import Tensor

from shift3d.sdf.field import Field
from shift3d.sdf.meshes import PointField, field_on_grid, zero_surface

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork
    from shift3d.vehicles.vehicle import Vehicle

RESOLUTION, COARSEST, MARGINS = 49, 12, (1.0, 0.6)
"""Nodes per axis of the unit sphere's cube, 10 cm apart on a car; first grid and margins of `field_on_grid`."""
_SURVEYED = 1024


def decoded_mesh(
    vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork, code: ArrayLike | Tensor, resolution: int = RESOLUTION
) -> trimesh.Trimesh:
    """Decode a vehicle's surface for a code (d,): object frame, metres.

    resolution: see `decoded_surface`.
    Raises: InputError when the code decodes to no surface. Differentiable w.r.t.: nothing.
    Source: our choice.
    """
    field = decoder.field(torch.as_tensor(code, dtype=torch.float32).detach())
    mesh = decoded_surface(field, resolution)
    mesh.vertices = vehicle.to_object(mesh.vertices)
    return mesh


def decoded_surface(field: PointField, resolution: int = RESOLUTION) -> trimesh.Trimesh:
    """Extract the zero surface of a decoder's field: sdf frame.

    resolution: nodes per axis of the unit sphere's cube: `COARSEST` times a power of two, plus one.
    Raises: InputError if the field has no surface.
    """
    return zero_surface(*field_on_grid(_restricted_to_unit_ball(field), resolution, COARSEST, MARGINS))


def _restricted_to_unit_ball(field: PointField) -> PointField:
    """Return the field restricted to the unit ball; outside it a positive function without a zero replaces the field.

    For a `Decoder` the hidden units that are off at _SURVEYED random points of the ball are removed, which saves two
    thirds of the time. Within 5 cm of the surface values differ by at most 0.5 mm for the shipped decoder and 3 mm for
    the wide decoder, whose values differ by more than 0.1 mm at four points in a thousand.
    """
    if isinstance(field, Field) and field.skip_layer >= 1:
        rng = torch.Generator().manual_seed(0)
        directions = torch.nn.functional.normalize(torch.randn(_SURVEYED, 3, generator=rng))
        places = directions * torch.rand(_SURVEYED, 1, generator=rng) ** (1 / 3)
        field = field.sliced(field.survey(places)[1])

    def inside(points: Tensor) -> Tensor:
        radius = points.norm(dim=1)
        values: Tensor = (radius - 1.0).clamp(min=0.0) + 0.05
        near = radius <= 1.0
        values[near] = field(points[near]).float()
        return values

    return inside
