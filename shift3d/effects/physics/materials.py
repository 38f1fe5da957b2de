"""What a vehicle's surface is made of, by the place on it, and how much light that sends back.

Object frame: x forward, y left, z up, origin at the centre of the vehicle's box; the tyres stand on its bottom.

Everywhere paint; glass in the band of the windows, all around (pillars are not told from windows); rubber in the rings
of the four tyres. Materials pass into each other over `EDGE_M`, linearly: the albedo is continuous in the place, so
that rounding changes it by no more than rounding.
"""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene
from shift3d.render.field.object_field import VehicleFrame

PAINT_ALBEDO, GLASS_ALBEDO, TYRE_ALBEDO = 0.4, 0.05, 0.04
"""Diffuse, near infrared, our choice: mid-grey paint, as the procedural street gives its vehicles where it draws none;
glass, which lets most of the light through and mirrors the rest away: what dirt and tint scatter back is left; carbon
black in rubber, which absorbs nearly all."""
DARKEST_ALBEDO = min(PAINT_ALBEDO, GLASS_ALBEDO, TYRE_ALBEDO)

EDGE_M = 0.04
"""Width over which one material passes into the next: about what a beam of 2 mrad covers at 20 m."""
GLASS_OF_HEIGHT = (0.62, 0.92)
"""From the belt line to the roof's edge, shares of the height: above the hoods, below the roofs of `vehicles.family`,
whose windscreens start at 0.6 to 0.7 of it."""
AXLES_OF_LENGTH = (0.31, -0.28)
"""Front and rear axle ahead of the centre, shares of the length. Measured on the shipped vehicles, as in
tests/unit/vehicles/mesh_dimensions.py: 0.30 to 0.32 and -0.26 to -0.29; production models (`vehicles.family.published`)
have wheelbases of 0.60 +- 0.02 of it."""
TYRE_OF_LENGTH = 0.075
"""Radius of a tyre, share of the length. Shipped vehicles: 0.071 to 0.084; production models: 0.073 +- 6 %, while by
height it would be +- 11 %."""
RIM_OF_TYRE = 0.62
"""Radius of the rim, share of the tyre's (a 16 inch rim in a tyre of 0.63 m); it is metal, as bright as paint."""
TYRE_WIDTH_M = 0.3
"""From the vehicle's side inwards: tyres are 0.2 to 0.3 m wide; farther in is the underbody."""


def albedo_of(points: Tensor, theta: Tensor, vehicle: VehicleFrame) -> Tensor:
    """Albedo of places on the vehicle.

    Args:
        points: (M, 3) float, on the vehicle, scene frame, metres.
        theta: (6,) pose of the vehicle, scene frame.
        vehicle: its box `size_m`; materials keep their places on it when an attack changes the shape.

    Returns: (M,) float64 in [`DARKEST_ALBEDO`, `PAINT_ALBEDO`]. Not finite where the point or the pose is not.

    Constant: not differentiable. Source: our choice.
    """
    length, width, height = (float(side) for side in vehicle.size_m)
    x, y, z = object_from_scene(points.detach().double(), theta.detach().double()).unbind(-1)
    low, high = ((share - 0.5) * height for share in GLASS_OF_HEIGHT)
    glass = _inside(z - low) * _inside(high - z)
    radius = TYRE_OF_LENGTH * length
    tyre = torch.zeros_like(x)
    for axle in AXLES_OF_LENGTH:
        from_axle = torch.hypot(x - axle * length, z + 0.5 * height - radius)
        tyre = tyre + _inside(radius - from_axle) * _inside(from_axle - RIM_OF_TYRE * radius)
    tyre = tyre * _inside(y.abs() - (0.5 * width - TYRE_WIDTH_M))
    # Written so that each material's albedo comes out exactly where it is the only one.
    above = glass * GLASS_ALBEDO + (1.0 - glass) * PAINT_ALBEDO
    return tyre * TYRE_ALBEDO + (1.0 - tyre) * above


def _inside(depth_m: Tensor) -> Tensor:
    """Share of a material at a depth inside its border: 0 and 1 half an edge away from it, linear between."""
    return (0.5 + depth_m / EDGE_M).clamp(0.0, 1.0)
