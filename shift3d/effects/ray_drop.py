"""Loss of the object's returns that are too weak to be detected."""

from __future__ import annotations

import math

import torch

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.effects.physics.materials import DARKEST_ALBEDO
from shift3d.effects.physics.power import OBJECT_FAR_M, detection_draws, detection_probability, echo_power, least_power
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.sensor import SensorModel

STEEP_RAD = math.radians(80.0)
"""Incidence at which the applicability is tested (our choice). Few beams meet a car at a larger angle, except at its
silhouette and on a roof or hood at the height of the sensor."""
LEAST_LOSS = 0.01
"""Least share of lost echoes at that incidence that can show: the weakest of the object's some hundred points."""


class RayDrop(Effect):
    """Loss of weak echoes: an echo of the object stays with the `power.detection_probability` of its power.

    power = albedo cos(incidence) / range^2 (`power.echo_power`), least power = 0.9 / limit_range_m^2. A row is kept if
    its uniform draw lies below the probability; for power_spread 0, if the power suffices.

    After fog, rain or snow the albedo is the apparent one, which contains their extinction. They have decided on that
    power before, with the same draws (`power.detection_draws`): this effect then loses no further echo, except for
    changes of the power by the weather's range noise.

    Leaves unchanged: points, reflectance, rows off the object or without a return. An infinite limit loses nothing.

    Differentiable: kept points keep their gradients. The gradient treats each echo as kept or lost for good: it ignores
    the dependence on range, incidence and material. Source: the power law and least power of LISA (Kilic et al. 2021);
    width of the transition: our choice.
    """

    name = "ray_drop"
    kind: Kind = "returns"
    reads_incidence = True

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if this sensor loses echoes of the darkest material far away at a steep angle."""
        limit_m = scene.sensor.limit_range_m
        if limit_m is None or not _has_limit(scene.sensor):
            return None
        albedo, cosine, far = torch.tensor([DARKEST_ALBEDO, math.cos(STEEP_RAD), OBJECT_FAR_M], dtype=torch.float64)
        power = echo_power(albedo, cosine, far)
        lost = 1.0 - float(detection_probability(power, scene.sensor))
        if not lost >= LEAST_LOSS:
            return None
        share = float(power) / least_power(limit_m)
        return (
            f"albedo {DARKEST_ALBEDO:g} at {OBJECT_FAR_M:g} m and {math.degrees(STEEP_RAD):.0f} degrees sends back "
            f"{share:.2g} of the least power: {100.0 * lost:.0f} % of such echoes are lost"
        )

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Draw one uniform value for every row of the beams."""
        sensor = context.scene.sensor
        if sensor is None or not _has_limit(sensor):
            return unchanged
        drawn = detection_draws(context)

        def step(returns: Returns) -> Returns:
            power = echo_power(returns.albedo, returns.cosine, returns.range_m.detach())
            lost = returns.on_object & returns.returned & ~(drawn[returns.row] < detection_probability(power, sensor))
            return returns.without(lost) if bool(lost.any()) else returns

        return step


def _has_limit(sensor: SensorModel) -> bool:
    """True if there is a least power above 0: the law takes its logarithm."""
    return sensor.limit_range_m is not None and math.isfinite(sensor.limit_range_m)


EFFECT = RayDrop()
