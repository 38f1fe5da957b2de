"""What a vehicle's surface is made of, by the place on it, and how much light that sends back."""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene
from shift3d.render.object_field import VehicleFrame

__all__ = ["GLASS_ALBEDO", "PAINT_ALBEDO", "TYRE_ALBEDO", "albedo_of"]

PAINT_ALBEDO, GLASS_ALBEDO, TYRE_ALBEDO = 0.4, 0.05, 0.04
"""Diffuse, near infrared: mid-grey paint; glass, which lets most of the light through; carbon black in rubber."""
_GLASS_FROM, _GLASS_TO = 0.62, 0.92
_TYRE_TO_M = 0.6


def albedo_of(points: Tensor, theta: Tensor, vehicle: VehicleFrame) -> Tensor:
    """(M,) float64 albedo in [0, 1] of points (M, 3) on the vehicle, scene frame; theta (6,) its pose.

    Paint, but glass in the band of the windows. Source: our choice.
    """
    x_object = object_from_scene(points.double(), theta.double())
    height = float(vehicle.size_m[2])
    share = x_object[:, 2] / height + 0.5
    glass = (share > _GLASS_FROM) & (share < _GLASS_TO)
    return torch.where(glass, GLASS_ALBEDO, torch.full_like(share, PAINT_ALBEDO))
