"""Range noise of the sensor on the object's points; the renderer places them exactly."""

from __future__ import annotations

from dataclasses import replace

import torch

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.scenes.facts import DetectorFacts, SceneFacts

LEAST_NOISE_M = 2e-6
"""Noise below this value is lost in the storage of points: half a step of float32 at 50 m (our choice)."""


class RangeNoise(Effect):
    """Noise of the range, sigma times a standard normal draw, along the beam only.

    Changes the object's points that have a return. Their new ranges may lie in front of the surface or behind it. A
    point that the noise would move behind its sensor has no return: no sensor reports a negative range.
    Leaves unchanged: beam directions, reflectance, and the scene's own noisy points.

    Differentiable: the noise is constant along the beam; a noisy point has the derivatives of the exact point.

    Source: our choice: one sigma a sensor, for all ranges and powers (sigma by signal-to-noise ratio needs a noise
    floor, which no recording states).
    """

    name = "range_noise"
    kind: Kind = "returns"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if the sensor states a noise that float32 can hold."""
        sigma_m = scene.sensor.range_noise_m
        if sigma_m is None or not sigma_m >= LEAST_NOISE_M:
            return None
        return f"ranges of this sensor scatter by {_length(sigma_m)}; inserted points would not at all"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Draw one value for every row of the beams."""
        sensor = context.scene.sensor
        sigma_m = 0.0 if sensor is None else sensor.range_noise_m or 0.0
        if sigma_m == 0.0:
            return unchanged
        drawn = context.draws(self.name).standard_normal(len(context.beams))
        noise_m = sigma_m * torch.from_numpy(drawn)

        def step(returns: Returns) -> Returns:
            noise, moved = noise_m[returns.row], returns.on_object & returns.returned
            behind = moved & (returns.range_m.detach() + noise <= 0.0)
            # Noise is added to the point, not to its range: the offset across the beam stays the same.
            points = returns.points + noise[:, None] * returns.directions
            noisy = replace(returns, points=torch.where(moved[:, None], points, returns.points))
            return noisy.without(behind) if bool(behind.any()) else noisy

        return step


def _length(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"


EFFECT = RangeNoise()
