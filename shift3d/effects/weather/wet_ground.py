"""Wet ground: darkening by a film of water."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from shift3d.effects.base import EffectContext, Returns, ReturnsStep, WeatherEffect, unchanged
from shift3d.effects.physics.power import DetectionLoss, echo_power
from shift3d.scenes.facts import DetectorFacts, SceneFacts

WATER_INDEX = 1.33
GROUND_BAND_M = 0.3
"""A point within this height of the nominal ground counts as ground."""
_DRY_ALBEDO, _TYPICAL_M = 0.3, 20.0


def fresnel_reflectance(cosine: Tensor, index: float = WATER_INDEX) -> Tensor:
    """Compute the share (K,) of unpolarised light that an interface of two media reflects. Source: Fresnel.

    Args:
        cosine: (K,) of incidence, in [0, 1]. index: refractive index behind the interface over that before it. If it is
            below 1 (from water into air), light beyond the critical angle is reflected wholly.
    """
    behind = (1.0 - (1.0 - cosine**2) / index**2).clamp(min=0.0).sqrt()
    # Both denominators vanish at grazing incidence (both cosines 0), where everything is reflected.
    tiny = torch.finfo(torch.float64).tiny
    across = (cosine - index * behind) / (cosine + index * behind).clamp(min=tiny)
    along = (index * cosine - behind) / (index * cosine + behind).clamp(min=tiny)
    share = 0.5 * (across**2 + along**2)
    return torch.where((cosine + behind) > 0.0, share, torch.ones_like(share))


@functools.cache
def internal_reflectance() -> float:
    """Compute R_wa: share of diffuse light from below that the water's surface reflects.

    Light takes the same path in both directions and spreads by n^2, so that 1 - R_wa = (1 - R_aw) / n^2. R_aw of
    diffuse light from above is the integral of 2 cos R(cos) d(cos), which is smooth: it has no critical angle.
    """
    node, weight = np.polynomial.legendre.leggauss(64)
    cosine = torch.from_numpy(0.5 * (node + 1.0))
    entering = float(((1.0 - fresnel_reflectance(cosine)) * cosine * torch.from_numpy(weight)).sum())
    return 1.0 - entering / WATER_INDEX**2


def wet_albedo(albedo: Tensor, cosine: Tensor) -> Tensor:
    """Compute the apparent albedo (K,) of diffuse ground under water, T_aw rho T_wa / (1 - rho R_wa).

    T_aw = 1 - R(incidence) enters the water. T_wa leaves it towards the sensor: the same transmission, and 1 / n^2
    because light that leaves water spreads over a wider angle. The surface reflects R_wa back to the ground, which
    scatters it diffusely again. Absorption in the water is neglected (a millimetre: 1 % at 905 nm).

    Args:
        albedo: (K,) of the dry ground. cosine: (K,) of incidence on the water.
    """
    through = 1.0 - fresnel_reflectance(cosine)
    return through * albedo * through / WATER_INDEX**2 / (1.0 - albedo * internal_reflectance())


class WetGround(WeatherEffect):
    """Film of water on the ground. It reduces albedo and reflectance; echoes below the sensor's least power are lost.

    Ground is a point within `GROUND_BAND_M` of the nominal height that is met from above. Its normal is vertical, so
    that the beam's direction gives the incidence. The feet of objects on the ground are wet alike. The film covers all
    of the ground at any rate (our choice); mirroring puddles are left out.

    Leaves unchanged: points, directions, the object, everything above the ground, and scenes whose points contain their
    weather. No rain changes nothing. Not differentiable.

    Source: Fresnel transmission both ways (reference equations); diffuse light inside: our choice (Lekner and Dorf
    1988).
    """

    name = "wet_ground"
    reads_incidence = False

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if the points do not contain the rain yet, and ground is in view."""
        conditions = scene.conditions
        if conditions.weather_in_points or not scene.ground_in_view:
            return None
        cosine = torch.tensor([1.73 / _TYPICAL_M], dtype=torch.float64)
        share = float(wet_albedo(torch.tensor([_DRY_ALBEDO], dtype=torch.float64), cosine)) / _DRY_ALBEDO
        return (
            f"rain {conditions.rain_mm_h:g} mm/h wets the ground: {100.0 * share:.0f} % of its echo is left "
            f"at {_TYPICAL_M:g} m"
        )

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Draw two values a beam."""
        conditions, sensor = context.scene.conditions, context.scene.sensor
        known = sensor is not None and sensor.limit_range_m is not None
        if conditions.rain_mm_h == 0.0 or conditions.weather_in_points or not known:
            return unchanged
        limit, ground_z_m = DetectionLoss.of(context, self.name), context.scene.ground_z_m
        return lambda returns: _wetted(returns, limit, ground_z_m)


def _wetted(returns: Returns, limit: DetectionLoss, ground_z_m: float) -> Returns:
    down = -returns.directions[:, 2]
    near = (returns.points.detach()[:, 2] - ground_z_m).abs() < GROUND_BAND_M
    ground = near & (down > 0.0) & returns.returned & ~returns.on_object
    if not bool(ground.any()):
        return returns
    albedo = torch.where(ground, wet_albedo(returns.albedo, down.clamp(0.0, 1.0)), returns.albedo)
    left = torch.where(returns.albedo > 0.0, albedo / returns.albedo.clamp(min=1e-12), 1.0)
    power = echo_power(returns.albedo, returns.cosine, returns.range_m.detach())
    lost = ground & limit.lost(returns, power, left)
    reflectance = returns.reflectance
    if reflectance is not None:
        reflectance = torch.where(ground, reflectance * left, reflectance)
    return replace(returns.without(lost), albedo=albedo, reflectance=reflectance)


EFFECT = WetGround()
