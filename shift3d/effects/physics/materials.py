"""Materials of a vehicle's surface by position, and their albedos.

Object frame: x forward, y left, z up, origin at the centre of the vehicle's box; the tyres touch the box's bottom.

Glass fills the band of the windows all around (pillars count as windows), rubber the rings of the four tyres, paint the
rest. Materials blend linearly over `EDGE_M`. The albedo is therefore continuous in the position, and a rounding error
of the position changes the albedo only by a rounding error.
"""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene
from shift3d.render.field.object_field import VehicleFrame

PAINT_ALBEDO, GLASS_ALBEDO, TYRE_ALBEDO = 0.4, 0.05, 0.04
"""Diffuse albedos, near infrared, our choice. Paint: mid grey, the procedural street's default for its vehicles. Glass
lets most of the light through and mirrors the rest away; dirt and tint scatter back. Rubber absorbs nearly all."""
DARKEST_ALBEDO = min(PAINT_ALBEDO, GLASS_ALBEDO, TYRE_ALBEDO)

EDGE_M = 0.04
"""Width of the transition between two materials: about the footprint of a beam of 2 mrad at 20 m."""
GLASS_OF_HEIGHT = (0.62, 0.92)
"""Belt line and roof edge, shares of the height: above the hoods and below the roofs of `vehicles.family`, whose
windscreens start at 0.6 to 0.7 of the height."""
AXLES_OF_LENGTH = (0.31, -0.28)
"""Front and rear axle ahead of the centre, shares of the length. Measured on the shipped vehicles as in
tests/unit/vehicles/mesh_dimensions.py: 0.30 to 0.32 and -0.26 to -0.29. Production models (`vehicles.family.published`)
have wheelbases of 0.60 +- 0.02 of the length."""
TYRE_OF_LENGTH = 0.075
"""Radius of a tyre, share of the length. Shipped vehicles: 0.071 to 0.084; production models: 0.073 +- 6 %. As a share
of the height it would scatter by +- 11 %."""
RIM_OF_TYRE = 0.62
"""Radius of the rim, share of the tyre's (a 16 inch rim in a tyre of 0.63 m). It is metal, as bright as paint."""
TYRE_WIDTH_M = 0.3
"""Width of a tyre from the vehicle's side inwards. Tyres are 0.2 to 0.3 m wide; the underbody lies farther in."""


def albedo_of(points: Tensor, theta: Tensor, vehicle: VehicleFrame) -> Tensor:
    """Compute the albedo of points on the vehicle.

    Args:
        points: (M, 3) float, on the vehicle, scene frame, metres.
        theta: (6,) pose of the vehicle, scene frame.
        vehicle: gives the box `size_m`. Materials keep their places on the vehicle if an attack changes its shape.

    Returns: (M,) float64 in [`DARKEST_ALBEDO`, `PAINT_ALBEDO`]. Not finite if the point or the pose is not.

    Not differentiable. Source: our choice.
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
    # In this form a position with one material alone gets exactly that material's albedo.
    above = glass * GLASS_ALBEDO + (1.0 - glass) * PAINT_ALBEDO
    return tyre * TYRE_ALBEDO + (1.0 - tyre) * above


def _inside(depth_m: Tensor) -> Tensor:
    """Compute a material's share at a depth inside its border: linear from 0 to 1 over an edge width."""
    return (0.5 + depth_m / EDGE_M).clamp(0.0, 1.0)
