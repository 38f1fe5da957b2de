"""Snow: flakes block part of the beam, and send light back."""

from __future__ import annotations

from shift3d.effects.base import DetectorFacts, EffectContext, Kind, ReturnsStep
from shift3d.effects.physics.power import LEAST_LOSS, loss, reach_m, unchanged
from shift3d.effects.rain import Particles, Precipitation
from shift3d.render.field.object_field import VehicleFrame
from shift3d.scenes.facts import SceneFacts

FLAKE_WIDTH = 1.5
"""Of a flake over the drop that it melts to, as a disc without holes (our choice: 1 mm/h then gives a visibility of
0.9 km and 2.5 mm/h of 0.6 km, where weather services set the bounds of moderate snow, 1 km and 0.5 km)."""
FLAKE_ALBEDO = 0.25
"""Of a diffuse disc that sends back as much: 2 pi / 25, by the ratio of extinction to backscatter of ice crystals,
some 25 sr (our choice)."""


def flakes(snow_mm_h: float) -> Particles:
    """Flakes of snow, by the width of the flake; the rate is of melted water.

    Source: Gunn and Marshall 1958, whose diameters are those of the melted drops.
    """
    return Particles(7600.0 * snow_mm_h**-0.87 / FLAKE_WIDTH, 2.55 * snow_mm_h**-0.48 / FLAKE_WIDTH, FLAKE_ALBEDO)


class Snow:
    """Extinction, and flakes that send back more than what lies behind them.

    A flake is a disc across the beam that covers the share (D / width)^2 of it; the nearest that covers enough to
    outdo the echo behind it becomes the return (`rain.Precipitation`, as for drops): met with the probability
    1 - exp(-Lambda). All others weaken that echo, by the mean extinction of snow. A flake's echo is not from the object
    (`on_object` False), with cosine 1 and the apparent albedo that gives its power.

    Echoes of surfaces are lost below the sensor's least power, where that is known, and scatter as in rain. Reflectance
    and albedo are from here on as seen through the snow. Left as they are: directions, cosine of surfaces, rows without
    a return (flakes in front of the sky are left out). No snow changes nothing.

    With fog and rain: each acts in turn on what the one before has left. Extinctions add up as they should; left out
    is that a flake is itself seen through the fog or rain in front of it.

    Differentiable: points that stay. The gradient ignores that echoes are lost or replaced; points of flakes,
    reflectance and albedo carry none.

    Source: Gunn and Marshall 1958 (sizes), Kilic et al. 2021 (limit); the rest: our choice.
    """

    name = "snow"
    kind: Kind = "returns"
    reads_incidence = True

    def applicability(self, scene: SceneFacts, vehicle: VehicleFrame, detector: DetectorFacts) -> str | None:
        """Where a hundredth of the light is lost as far as there is something to see."""
        rate = scene.conditions.snow_mm_h
        if rate == 0.0:
            return None
        extinction = flakes(rate).extinction_per_m
        if loss(extinction, reach_m(scene.conditions)) < LEAST_LOSS:
            return None
        return f"snow {rate:g} mm/h: {100.0 * loss(extinction, 30.0):.2g} % of the light is lost at 30 m and back"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Three draws a beam, and two more where the sensor's limit is known."""
        rate = context.scene.conditions.snow_mm_h
        if rate == 0.0:
            return unchanged
        return Precipitation.of(context, self.name, flakes(rate)).act

    def on_scene(self, context: EffectContext) -> bool:
        """Where the scene's points are those of dry air."""
        return not context.scene.conditions.weather_in_points


EFFECT = Snow()
