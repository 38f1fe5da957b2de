"""Hard cases of effects: echoes without power, weather at its extremes, rows without a beam."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from catalogue import hard_case
from clear_errors import refused
from hard_echoes import (
    AHEAD,
    READER,
    ahead,
    drawn,
    finite,
    on_object,
    reported,
    scene_of,
    share_returned,
    within_3_sigma,
    without_tables,
)

from shift3d.effects.applicability import effect_named
from shift3d.effects.chain import NO_RETURN_M
from shift3d.effects.physics import power
from shift3d.effects.physics.power import DetectionLoss
from shift3d.effects.weather import fog, precipitation, rain, snow
from shift3d.effects.weather.wet_ground import fresnel_reflectance
from shift3d.scenes.facts import EffectSettings, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

AREA = "effects"


@hard_case(
    area=AREA,
    why="of the light at the first metre exp(-5400) is left, which is 0 in float64",
    must="every surface beyond a metre is an echo of fog at 0.9 m, finite, and none behind its surface",
    guard="the echo of fog is a logarithm, with the loss up to its beginning taken out",
)
def a_visibility_of_a_millimetre() -> None:
    without_tables()
    context, returns = on_object(ahead(30.0, 4), Conditions("fog", visibility_m=1e-3), None)
    seen = fog.EFFECT.bind(context)(returns)
    finite(seen)
    assert seen.returned.all() and not seen.on_object.any()
    assert ((seen.range_m >= 0.9) & (seen.range_m < 0.901)).all()


@hard_case(
    area=AREA,
    why="a power is divided by the square of a limit, which of 1e-170 m is 0; the echo of a fog of 1e-300 m ends "
    "nearer to its beginning than any two places in float64 are",
    must="an error that names the setting, of a scene's own as well; the least that is allowed gives finite points",
    guard="what no sensor and no weather is near is refused, zero or not",
)
def settings_of_effects_next_to_zero() -> None:
    least = {"limit_range_m": 1e-3, "power_spread": 1e-9, "visibility_m": 1e-3}
    below = [("limit_range_m", 1e-170), ("limit_range_m", 1e-160), ("power_spread", 5e-324)]
    below += [("visibility_m", 1e-300), ("visibility_m", 5e-324), ("object_speed_m_s", 1e300)]
    every = ["wet_ground", "fog", "rain", "snow", "ray_drop"]
    for name, value in below:
        refused(lambda name=name, value=value: EffectSettings(**{name: value}), name)  # type: ignore[misc]
    refused(lambda: Conditions("fog", visibility_m=1e-300).validate("made"), "conditions.visibility_m")
    refused(lambda: SensorModel(limit_range_m=1e-170).validate("made"), "sensor.limit_range_m")
    for value in (1e-3, 1e3):
        without_tables()
        drawn(ahead(30.0, 40, reflectance=reported(0.5)), every, AHEAD, **least, rain_mm_h=value, snow_mm_h=value)


@hard_case(
    area=AREA,
    why="the loss of light is 1 less a number that is nearly 1",
    must="2 alpha R to twelve digits, and above 0 for 1e18 m; fog is not called for",
    guard="the loss is taken from expm1",
)
def a_visibility_of_a_million_kilometres() -> None:
    for visibility_m in (1e9, 1e18):
        thin = 60.0 * fog.extinction_per_m(visibility_m)
        assert abs(power.loss(thin / 60.0, 30.0) / (thin - 0.5 * thin**2) - 1.0) < 1e-12
        facts = SceneFacts.of(ahead(30.0, 4), EffectSettings(visibility_m=visibility_m, limit_range_m=50.0))
        assert fog.EFFECT.applicability(facts, READER) is None


@hard_case(
    area=AREA,
    why="a scene may lose each of its points",
    must="every row keeps its place, finite and far out; none of them counts as returned",
    guard="what the weather took from the scene rests far out",
)
def a_scene_in_which_every_point_is_lost_in_fog() -> None:
    scene = ahead(60.0, 50, reflectance=reported(1.0))
    rendering = drawn(scene, ["fog", "ray_drop"], visibility_m=500.0, limit_range_m=70.0)
    assert len(rendering.points) == 50 and share_returned(rendering) == 0.0
    assert (rendering.points.norm(dim=1) == NO_RETURN_M).all() and (rendering.range_m == NO_RETURN_M).all()


@hard_case(
    area=AREA,
    why="the tables of drops take the logarithm of the power to outdo, which is 0 for a surface along the beam",
    must="such echoes are weakened and power_to_exceed by drops; nothing is NaN",
    guard="powers outside a table are taken for those at its ends, before the logarithm",
)
def a_surface_met_at_90_degrees_in_rain() -> None:
    context, returns = on_object(ahead(30.0, 200), Conditions("rain", rain_mm_h=1000.0), None, cosine=0.0)
    seen = rain.EFFECT.bind(context)(returns)
    finite(seen)
    assert not seen.on_object.any() and (seen.range_m < 30.0).all()


@hard_case(
    area=AREA,
    why="its echo has no power at all, and a draw may be exactly 0",
    must="it is lost under a sharp limit and under a soft one",
    guard="an echo comes back where its draw lies below its probability, not at it",
)
def a_surface_met_at_90_degrees_with_the_luckiest_draw() -> None:
    _, returns = on_object(ahead(30.0, 3), Conditions(), None, cosine=0.0)
    luck, echo = torch.zeros(3, dtype=torch.float64), power.echo_power(returns.albedo, returns.cosine, returns.range_m)
    for spread in (0.0, 0.5):
        limit = DetectionLoss(SensorModel(limit_range_m=80.0, power_spread=spread), power.least_power(80.0), luck, luck)
        assert limit.lost(returns, echo, torch.ones_like(luck)).all()


@hard_case(
    area=AREA,
    why="power falls with the square of a range that is 0",
    must="the row stays where it is, bit for bit, and its power is 0",
    guard="nearer than the receiver sees anything, the power is not divided by the range",
)
def a_row_without_a_beam_in_rain() -> None:
    scene = scene_of([[20.0, 0.0, 0.0], [0.0, 0.0, 0.0], [15.0, 3.0, 0.0]])
    rendering = drawn(scene, ["rain", "ray_drop"], rain_mm_h=20.0, limit_range_m=100.0)
    assert rendering.points[1].tolist() == [0.0, 0.0, 0.0] and float(rendering.range_m[1]) == 0.0


@hard_case(
    area=AREA,
    why="it has no direction in which it could rest far out",
    must="it is neither moved nor counted as lost, as without fog",
    guard="only beams can lose their return",
)
def a_row_without_a_beam_in_fog() -> None:
    scene = scene_of([[20.0, 0.0, 0.0], [0.0, 0.0, 0.0], [15.0, 3.0, 0.0]])
    rendering = drawn(scene, ["fog"], visibility_m=50.0, limit_range_m=90.0)
    assert rendering.returned is not None and bool(rendering.returned[1])
    assert rendering.points[1].tolist() == [0.0, 0.0, 0.0] and float(rendering.range_m[1]) == 0.0


@hard_case(
    area=AREA,
    why="the receiver sees nothing nearer than 0.9 m, so that the noise of an echo there is infinite",
    must="such points of a scene keep their range",
    guard="an echo that was noticed has at least the least power, before the rain and in it",
)
def points_on_the_sensors_own_roof_in_rain() -> None:
    scene = ahead(0.6, 100)
    rendering = drawn(scene, ["rain"], rain_mm_h=30.0, limit_range_m=100.0)
    kept = rendering.range_m < 1.0
    assert kept.sum() > 80 and torch.equal(rendering.points[kept], torch.from_numpy(scene.points)[kept])


@hard_case(
    area=AREA,
    why="the flake that would send as much would be wider than the beam",
    must="no flake outdoes it, however hard it snows",
    guard="a particle sends back no more than one that fills the beam",
)
def a_snowfall_of_1000_mm_an_hour_before_a_mirror() -> None:
    without_tables()
    table = precipitation.crossings(snow.flakes(1000.0), 2e-3)
    assert table.expected[-1].tolist() == [0.0] * table.expected.shape[1] and table.expected[0, -1] > 0.0


@hard_case(
    area=AREA,
    why="a limit that is sharp cannot have let such an echo pass, and yet it is in the recording",
    must="thin fog takes the share of light that it takes from all, not every such point",
    guard="what came back from below a sharp limit survives with the light that is left",
)
def a_reported_reflectance_of_0_under_a_sharp_limit() -> None:
    scene = ahead(40.0, 2000, reflectance=reported(0.0))
    share = share_returned(drawn(scene, ["fog"], visibility_m=2000.0, limit_range_m=100.0))
    within_3_sigma(share, 1.0 - power.loss(fog.extinction_per_m(2000.0), 40.0), 2000)


@hard_case(
    area=AREA,
    why="the logarithm of its power is infinite, before the fog and in it",
    must="the share that is kept is the limit for weak echoes, the light that is left to the power 1 / spread",
    guard="the logarithm is taken of no less than 1e-300",
)
def a_reported_reflectance_of_0_under_a_soft_limit() -> None:
    scene = ahead(40.0, 2000, reflectance=reported(0.0))
    share = share_returned(drawn(scene, ["fog"], visibility_m=2000.0, limit_range_m=100.0, power_spread=0.5))
    within_3_sigma(share, (1.0 - power.loss(fog.extinction_per_m(2000.0), 40.0)) ** 2, 2000)


@hard_case(
    area=AREA,
    why="the chances to be noticed, before and in fog, are both 0 in float64, and their quotient is asked for",
    must="the light that is left to the power 1 / spread",
    guard="the quotient is a difference of logarithms",
)
def an_echo_far_below_a_limit_that_is_nearly_sharp() -> None:
    scene = ahead(40.0, 2000, reflectance=reported(1e-5))
    share = share_returned(drawn(scene, ["fog"], visibility_m=3e4, limit_range_m=100.0, power_spread=0.01))
    within_3_sigma(share, math.exp(-2.0 * fog.extinction_per_m(3e4) * 40.0 / 0.01), 2000)


@hard_case(
    area=AREA,
    why="what water leaves of an echo is a quotient of two albedos that are both 0",
    must="it reports 0, and is not NaN",
    guard="the quotient is taken where there is an albedo",
)
def a_ground_of_reflectance_0_that_gets_wet() -> None:
    scene = scene_of([[10.0, 0.0, -1.7]] * 9, reflectance=np.zeros(9, np.float32))
    rendering = drawn(scene, ["wet_ground"], rain_mm_h=5.0, limit_range_m=80.0)
    assert rendering.reflectance is not None and rendering.reflectance.tolist() == [0.0] * 9


@hard_case(
    area=AREA,
    why="both of Fresnel's quotients are 0 / 0 along a face that light cannot leave the water through",
    must="all light is reflected, as at every angle beyond the critical one",
    guard="light along a face on both of its sides is reflected",
)
def light_along_the_water_from_below() -> None:
    cosine = torch.tensor([0.0, 1e-9, 0.1, 0.5], dtype=torch.float64)
    assert torch.allclose(
        fresnel_reflectance(cosine, 1.0 / 1.33), torch.ones(4, dtype=torch.float64), rtol=0, atol=1e-12
    )


@hard_case(
    area=AREA,
    why="the least power is 0, and its logarithm is taken",
    must="no echo is lost, in clear air and in fog, as if the limit were unknown",
    guard="an infinite limit is none",
)
def a_limit_infinitely_far_away() -> None:
    sensor = SensorModel(limit_range_m=math.inf, power_spread=0.5)
    context, returns = on_object(ahead(10.0, 5), Conditions("fog", visibility_m=500.0), sensor, albedo=0.0)
    for name in ("fog", "ray_drop"):
        step: Any = effect_named(name).bind(context)
        assert step(returns).returned.all()


@hard_case(
    area=AREA,
    why="it takes nothing from any echo that float32 could hold",
    must="rain is not called for; forced, every row returns, and moves by less than a hundredth of a millimetre",
    guard="rain is called for by the light that it takes, not by its rate",
)
def a_rain_of_a_trillionth_of_a_millimetre_an_hour() -> None:
    scene = ahead(30.0, 50)
    facts = SceneFacts.of(scene, EffectSettings(rain_mm_h=1e-12))
    assert rain.EFFECT.applicability(facts, READER) is None
    rendering = drawn(scene, ["rain"], rain_mm_h=1e-12, limit_range_m=100.0)
    assert share_returned(rendering) == 1.0 and ((rendering.range_m - 30.0).abs() < 1e-5).all()
