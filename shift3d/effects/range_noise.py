"""Range noise of the sensor on the object's points, which an insertion places exactly."""

from __future__ import annotations

from dataclasses import replace

import torch

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.scenes.facts import DetectorFacts, SceneFacts

LEAST_NOISE_M = 2e-6
"""Noise below this is lost in what points are stored in: half a step of float32 at 50 m (our choice)."""


class RangeNoise(Effect):
    """range + sigma times a standard normal draw, along the beam and nowhere else.

    Changed are the object's points that come back; ranges may then lie in front of the surface or behind it. Left as
    they are: the direction of every beam, which rows return, reflectance, and the scene's own points, which bear
    the noise of the recording already.

    Differentiable: the noise is a constant added along the beam, so that a noisy point has the derivatives of the
    exact one. Nothing is ignored.

    Source: our choice: one sigma a sensor, whatever the range and the echo's power (sigma by signal-to-noise ratio
    needs a noise floor that no recording states).
    """

    name = "range_noise"
    kind: Kind = "returns"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Where the sensor states a noise that float32 can hold."""
        sigma_m = scene.sensor.range_noise_m
        if sigma_m is None or not sigma_m >= LEAST_NOISE_M:
            return None
        return f"ranges of this sensor scatter by {_length(sigma_m)}; inserted points would not at all"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """One draw for every row of the beams."""
        sensor = context.scene.sensor
        sigma_m = 0.0 if sensor is None else sensor.range_noise_m or 0.0
        if sigma_m == 0.0:
            return unchanged
        drawn = context.draws(self.name).standard_normal(len(context.beams))
        noise_m = sigma_m * torch.from_numpy(drawn)

        def step(returns: Returns) -> Returns:
            moved = returns.on_object & returns.returned
            # Added to the point, not to its range: what lies across the beam stays as it is.
            points = returns.points + noise_m[returns.row, None] * returns.directions
            return replace(returns, points=torch.where(moved[:, None], points, returns.points))

        return step


def _length(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"


EFFECT = RangeNoise()
