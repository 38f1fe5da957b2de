"""The power of an echo, and whether the sensor notices it: one law for ray drop, weather and wet ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.effects.base import EffectContext, Returns
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

OVERLAP_FROM_M, OVERLAP_TO_M = 0.9, 1.0
"""Between these ranges the receiver comes to see what the laser lights (Hahner et al. 2021)."""
LIMIT_ALBEDO = 0.9
"""Of the surface by which `SensorModel.limit_range_m` is stated."""
OBJECT_FAR_M, SCENE_FAR_M = 50.0, 120.0
"""How far the object lies at most (the paper's 15 to 50 m), and what a scene shows (our choice)."""
LEAST_LOSS = 0.01
"""Share of the light below which a loss cannot matter (our choice: the step in which reflectance is reported)."""
_NO_POWER = 1e-300


def overlap(range_m: Tensor) -> Tensor:
    """xi(R) in [0, 1], rising linearly over 0.9 to 1.0 m; shape and dtype of range_m, metres."""
    return ((range_m - OVERLAP_FROM_M) / (OVERLAP_TO_M - OVERLAP_FROM_M)).clamp(0.0, 1.0)


def echo_power(albedo: Tensor, cosine: Tensor, range_m: Tensor) -> Tensor:
    """Power of echoes in clear air, albedo * cosine * xi(R) / R^2, up to the sensor's constant.

    Args:
        albedo: (K,) in [0, 1]. cosine: (K,) of incidence, in [0, 1]. range_m: (K,), metres.

    Returns: (K,) in 1/m^2; 0 nearer than 0.9 m, whatever the range. Differentiable w.r.t. all three.

    Source: reference equations of echo power (Rasshofer et al. 2011); constant as in `least_power`.
    """
    return albedo * cosine * overlap(range_m) / range_m.clamp(min=OVERLAP_FROM_M) ** 2


def least_power(limit_range_m: float) -> float:
    """Power, 1/m^2, that an echo needs to be noticed: 0.9 / limit_range_m^2 (see `SensorModel`).

    Source: Kilic et al. 2021 (LISA).
    """
    return LIMIT_ALBEDO / limit_range_m**2


def survival(power: Tensor, sensor: SensorModel) -> Tensor:
    """Probability (K,) float64 that echoes of a power (K,), 1/m^2, are noticed.

    Sharp at the least power where `power_spread` is 0, else logistic in the log of power with that width, one half
    at the least power; 1 where the limit is unknown. Differentiable where it is not sharp.

    Source: our choice, as the procedural streets lose returns.
    """
    if sensor.limit_range_m is None:
        return torch.ones_like(power, dtype=torch.float64)
    least = least_power(sensor.limit_range_m)
    if sensor.power_spread == 0.0:
        return (power >= least).double()
    return torch.sigmoid((power.double().log() - math.log(least)) / sensor.power_spread)


def survival_draws(context: EffectContext) -> Tensor:
    """(N,) float64 uniform in [0, 1), one a beam: an echo is noticed where the draw lies below `survival`.

    All effects that lose echoes of the object share these: the same beam is not tried twice with different luck, so
    that rain, then ray drop, lose together what the weakest power of the two loses.
    """
    return torch.from_numpy(context.draws("power", "survival").random(len(context.beams)))


def loss(extinction_per_m: float, range_m: float) -> float:
    """Share of the light that is lost on the way there and back: 1 - exp(-2 alpha R), Beer and Lambert."""
    return -math.expm1(-2.0 * extinction_per_m * range_m)


def reach_m(conditions: Conditions) -> float:
    """How far away weather can change a point, metres: the object alone where it is in the scene's points already."""
    return OBJECT_FAR_M if conditions.weather_in_points else SCENE_FAR_M


@dataclass(frozen=True)
class PowerLimit:
    """Losses of one effect that weakens echoes.

    sensor, least: whose limit, and its least power, 1/m^2. shared, own: (N,) draws, see `survival_draws`; None where
    the limit is unknown or infinitely far away.
    """

    sensor: SensorModel
    least: float = 0.0
    shared: Tensor | None = None
    own: Tensor | None = None

    @staticmethod
    def of(context: EffectContext, effect: str) -> PowerLimit:
        """The limit of the context's sensor, with the draws of one effect."""
        sensor = context.scene.sensor or SensorModel()
        if sensor.limit_range_m is None or math.isinf(sensor.limit_range_m):  # no least power
            return PowerLimit(sensor)
        own = torch.from_numpy(context.draws(effect, "survival").random(len(context.beams)))
        return PowerLimit(sensor, least_power(sensor.limit_range_m), survival_draws(context), own)

    def lost(self, returns: Returns, power: Tensor, transmission: Tensor) -> Tensor:
        """(K,) bool: echoes that are not noticed any more, of those that are returned.

        Args:
            returns: K rows. power: (K,) before the effect, 1/m^2. transmission: (K,) in [0, 1], what is left of it.

        What lies on the object has to be noticed at all. Everything else is known to have been noticed before, so
        that only the effect's part counts: survival(after) / survival(before). Not differentiable.
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
                lost[chosen] = self.shared[row] >= survival(before * share, self.sensor)
            else:
                lost[chosen] = self.own[row] >= self._share_kept(before, share)
        return lost

    def _share_kept(self, before: Tensor, transmission: Tensor) -> Tensor:
        """(K,) of echoes known to have been noticed.

        A sharp limit cannot explain an echo from below it (its reflectance may be reported as 0): how far it really
        was above is unknown. Our choice: by an exponentially distributed log of power with mean 1; it then survives
        with the probability `transmission`. A soft limit gives transmission^(1 / power_spread) there by itself.
        """
        least, spread = self.least, self.sensor.power_spread
        if spread == 0.0:
            return torch.where(before >= least, (before * transmission >= least).double(), transmission)
        x = (before.clamp(min=_NO_POWER).log() - math.log(least)) / spread
        after = x + transmission.clamp(min=_NO_POWER).log() / spread
        return torch.exp(torch.nn.functional.logsigmoid(after) - torch.nn.functional.logsigmoid(x))
