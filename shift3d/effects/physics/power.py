"""Echo power and detection probability: one law for ray drop, weather and wet ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.effects.base import EffectContext, Returns
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

OVERLAP_FROM_M, OVERLAP_TO_M = 0.9, 1.0
"""Ranges between which the receiver's view starts to overlap with the laser beam (Hahner et al. 2021)."""
LIMIT_ALBEDO = 0.9
"""Albedo of the surface that defines `SensorModel.limit_range_m`."""
OBJECT_FAR_M, SCENE_FAR_M = 50.0, 120.0
"""Largest distance of the object (the paper's 15 to 50 m), and of a scene's points (our choice)."""
LEAST_LOSS = 0.01
"""A loss of light below this share cannot matter (our choice: the resolution of reported reflectance)."""
_NO_POWER = 1e-300


def overlap(range_m: Tensor) -> Tensor:
    """Compute the overlap xi(R) in [0, 1]: rises linearly from 0.9 to 1.0 m; shape and dtype of range_m, metres."""
    return ((range_m - OVERLAP_FROM_M) / (OVERLAP_TO_M - OVERLAP_FROM_M)).clamp(0.0, 1.0)


def echo_power(albedo: Tensor, cosine: Tensor, range_m: Tensor) -> Tensor:
    """Compute the echo power in clear air, albedo * cosine * xi(R) / R^2, up to the sensor's constant.

    Args:
        albedo: (K,) in [0, 1]. cosine: (K,) of incidence, in [0, 1]. range_m: (K,), metres.

    Returns: (K,) in 1/m^2; 0 for any range below 0.9 m. Differentiable w.r.t. all three. Source: reference equations of
    echo power (Rasshofer et al. 2011); constant as in `least_power`.
    """
    return albedo * cosine * overlap(range_m) / range_m.clamp(min=OVERLAP_FROM_M) ** 2


def least_power(limit_range_m: float) -> float:
    """Compute the least detectable echo power, 1/m^2: 0.9 / limit_range_m^2. Source: Kilic et al. 2021 (LISA)."""
    return LIMIT_ALBEDO / limit_range_m**2


def detection_probability(power: Tensor, sensor: SensorModel) -> Tensor:
    """Compute the detection probability (K,) float64 of echoes of a power (K,), 1/m^2.

    For `power_spread` 0 the limit is sharp at the least power. Otherwise the probability is logistic in log power, with
    that width and one half at the least power. Without a limit it is 1. Differentiable if the limit is not sharp.
    Source: our choice, as the procedural streets lose returns.
    """
    if sensor.limit_range_m is None:
        return torch.ones_like(power, dtype=torch.float64)
    least = least_power(sensor.limit_range_m)
    if sensor.power_spread == 0.0:
        return (power >= least).double()
    return torch.sigmoid((power.double().log() - math.log(least)) / sensor.power_spread)


def detection_draws(context: EffectContext) -> Tensor:
    """Draw (N,) float64 uniform in [0, 1), one a beam. A draw below `detection_probability` detects the echo.

    All effects that lose echoes of the object share these draws. Rain followed by ray drop therefore loses the same
    echoes as one test with the weaker of both powers, and no beam is tried twice with different luck.
    """
    return torch.from_numpy(context.draws("power", "survival").random(len(context.beams)))


def loss(extinction_per_m: float, range_m: float) -> float:
    """Compute the share of light lost on the way there and back: 1 - exp(-2 alpha R), Beer and Lambert."""
    return -math.expm1(-2.0 * extinction_per_m * range_m)


def reach_m(conditions: Conditions) -> float:
    """Return the reach of weather, metres. Weather that the points contain already changes the object only."""
    return OBJECT_FAR_M if conditions.weather_in_points else SCENE_FAR_M


@dataclass(frozen=True)
class DetectionLoss:
    """Losses caused by one effect that weakens echoes.

    sensor, least: the sensor and its least power, 1/m^2. shared, own: (N,) `detection_draws`; None: no limit.
    """

    sensor: SensorModel
    least: float = 0.0
    shared: Tensor | None = None
    own: Tensor | None = None

    @staticmethod
    def of(context: EffectContext, effect: str) -> DetectionLoss:
        """Return the limit of the context's sensor, with the draws of one effect."""
        sensor = context.scene.sensor or SensorModel()
        if sensor.limit_range_m is None or math.isinf(sensor.limit_range_m):  # no least power
            return DetectionLoss(sensor)
        own = torch.from_numpy(context.draws(effect, "survival").random(len(context.beams)))
        return DetectionLoss(sensor, least_power(sensor.limit_range_m), detection_draws(context), own)

    def lost(self, returns: Returns, power: Tensor, transmission: Tensor) -> Tensor:
        """Return the mask (K,) of the returns that the effect makes undetectable.

        Args:
            returns: K rows. power: (K,) before the effect, 1/m^2. transmission: (K,) in [0, 1], the share that is left.

        An echo of the object must be detectable at all. Any other echo is known to have been detected before the
        effect, so that its probability is survival(after) / survival(before). Not differentiable.
        """
        lost = torch.zeros_like(returns.returned)
        if self.shared is None or self.own is None:
            return lost
        for on_object in (True, False):
            chosen = (returns.returned & (returns.on_object == on_object)).nonzero().squeeze(1)
            if not len(chosen):
                continue
            row, before, share = returns.row[chosen], power[chosen], transmission[chosen]
            if on_object:
                lost[chosen] = self.shared[row] >= detection_probability(before * share, self.sensor)
            else:
                lost[chosen] = self.own[row] >= self._share_kept(before, share)
        return lost

    def _share_kept(self, before: Tensor, transmission: Tensor) -> Tensor:
        """Compute the detection probability (K,) after the effect, given detection before it.

        A sharp limit cannot explain an echo with less than the least power (its reflectance may be reported as 0); its
        true excess is unknown. Our choice: its log power is exponentially distributed above the limit with mean 1, so
        that it survives with the probability `transmission`. A soft limit gives transmission^(1 / power_spread).
        """
        least, spread = self.least, self.sensor.power_spread
        if spread == 0.0:
            return torch.where(before >= least, (before * transmission >= least).double(), transmission)
        x = (before.clamp(min=_NO_POWER).log() - math.log(least)) / spread
        after = x + transmission.clamp(min=_NO_POWER).log() / spread
        return torch.exp(torch.nn.functional.logsigmoid(after) - torch.nn.functional.logsigmoid(x))
