"""The surface that a decoder draws for a code, in a fifth of a second: coarse to fine, where the surface can be."""

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
"""Nodes along the unit sphere's cube, 10 cm apart on a car, and cells of the first grid."""
_SURVEYED = 1024


def decoded_mesh(
    vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork, code: ArrayLike | Tensor, resolution: int = RESOLUTION
) -> trimesh.Trimesh:
    """What a vehicle looks like under a code (d,): object frame, metres.

    resolution: see `decoded_surface`.
    Raises: InputError when the code decodes to no surface. Differentiable w.r.t.: nothing.
    Source: our choice.
    """
    field = decoder.field(torch.as_tensor(code, dtype=torch.float32).detach())
    mesh = decoded_surface(field, resolution)
    mesh.vertices = vehicle.to_object(mesh.vertices)
    return mesh


def decoded_surface(field: PointField, resolution: int = RESOLUTION) -> trimesh.Trimesh:
    """The zero surface of a decoder's field: sdf frame.

    resolution: nodes along the unit sphere's cube, one more than `COARSEST` doubled some times.
    Raises: InputError where there is none.
    """
    return zero_surface(*field_on_grid(_in_the_ball(field), resolution, COARSEST, MARGINS))


def _in_the_ball(field: PointField) -> PointField:
    """The field evaluated inside the unit ball alone; outside it is the distance from the ball, which is no surface's.

    A decoder of our own loses the hidden units that are off at a thousand places all over the ball: two thirds of the
    time. Within 5 cm of the surface values differ by 0.5 mm at most for the shipped decoder and by 3 mm for the wide
    one, whose values differ by more than 0.1 mm at four places of a thousand.
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
