"""Returns of the object that are too weak to be detected."""

from __future__ import annotations

import math

import torch

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.effects.physics.materials import DARKEST_ALBEDO
from shift3d.effects.physics.power import OBJECT_FAR_M, echo_power, least_power, survival, survival_draws
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.sensor import SensorModel

STEEP_RAD = math.radians(80.0)
"""Incidence that is asked about (our choice): the flatter a surface is met, the fewer beams meet it; few meet a car at
more, beside its silhouette and on a roof or hood seen from their own height."""
LEAST_LOSS = 0.01
"""Share of lost echoes there below which nothing is to be seen: the weakest of the object's some hundred points."""


class RayDrop(Effect):
    """An echo of the object comes back with the probability that its power gives, `power.survival`.

    power = albedo cos(incidence) / range^2 (`power.echo_power`), least power = 0.9 / limit_range_m^2; a row is kept
    where its uniform draw lies below the probability (for power_spread 0: where the power suffices).

    In clear air: the extinction of fog, rain and snow is NOT applied here, their effects have decided on it before.
    They lose the object's echoes by the same draws (`power.survival_draws`), so that judging twice takes no more than
    judging once by the weaker of both powers.

    Left as they are: points, reflectance, rows that are not on the object, and those that bring nothing back already.
    A limit infinitely far away loses nothing.

    Differentiable: points that stay keep their gradients. The gradient ignores that echoes come and go with range,
    incidence and material: it sees each as kept or lost for good.

    Source: the power law and least power of LISA (Kilic et al. 2021); width of the transition: our choice.
    """

    name = "ray_drop"
    kind: Kind = "returns"
    reads_incidence = True

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Where the darkest material, far out and at a flat angle, loses echoes to this sensor."""
        limit_m = scene.sensor.limit_range_m
        if limit_m is None or not _has_limit(scene.sensor):
            return None
        albedo, cosine, far = torch.tensor([DARKEST_ALBEDO, math.cos(STEEP_RAD), OBJECT_FAR_M], dtype=torch.float64)
        power = echo_power(albedo, cosine, far)
        lost = 1.0 - float(survival(power, scene.sensor))
        if not lost >= LEAST_LOSS:
            return None
        share = float(power) / least_power(limit_m)
        return (
            f"albedo {DARKEST_ALBEDO:g} at {OBJECT_FAR_M:g} m and {math.degrees(STEEP_RAD):.0f} degrees sends back "
            f"{share:.2g} of the least power: {100.0 * lost:.0f} % of such echoes are lost"
        )

    def bind(self, context: EffectContext) -> ReturnsStep:
        """One uniform draw for every row of the beams."""
        sensor = context.scene.sensor
        if sensor is None or not _has_limit(sensor):
            return unchanged
        drawn = survival_draws(context)

        def step(returns: Returns) -> Returns:
            power = echo_power(returns.albedo, returns.cosine, returns.range_m.detach())
            lost = returns.on_object & returns.returned & ~(drawn[returns.row] < survival(power, sensor))
            return returns.without(lost) if bool(lost.any()) else returns

        return step


def _has_limit(sensor: SensorModel) -> bool:
    """Whether there is a least power above 0: the law takes its logarithm."""
    return sensor.limit_range_m is not None and math.isfinite(sensor.limit_range_m)


EFFECT = RayDrop()
