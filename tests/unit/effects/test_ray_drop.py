"""Lost echoes against the survival law, and rows that the law leaves alone."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from analytic_fields import Frame

from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.physics.materials import DARKEST_ALBEDO
from shift3d.effects.physics.power import OBJECT_FAR_M, DetectionLoss, echo_power
from shift3d.effects.ray_drop import EFFECT, STEEP_RAD
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Scene
from shift3d.scenes.sensor import SensorModel

COUNT = 40_000
LIMIT_M = 120.0
DETECTOR = DetectorFacts("reader")


def context_of(limit_m: float | None, spread: float = 0.0, count: int = COUNT, seed: int = 5) -> EffectContext:
    """Return beams that end 20 m away from the origin, in all directions."""
    rng = np.random.default_rng(1)
    points = rng.standard_normal((count, 3))
    points = (20.0 * points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    sensor = SensorModel(limit_range_m=limit_m, power_spread=spread)
    scene = Scene("faint", "made", points, np.zeros((count, 3), np.float32), -1.7, sensor=sensor)
    return EffectContext(scene, Beams.from_scene(scene), Frame(), seed)


def returns_of(
    context: EffectContext, albedo: float | None = None, cosine: float = 1.0, range_m: float = 20.0
) -> Returns:
    """Return all rows on the object at one range; albedo None: uniform in [0, 1]."""
    beams, count = context.beams, len(context.beams)
    yes = torch.ones(count, dtype=torch.bool)
    drawn = torch.rand(count, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    cosines = torch.full((count,), cosine, dtype=torch.float64)
    albedos = drawn if albedo is None else torch.full_like(drawn, albedo)
    points = beams.origins + range_m * beams.directions
    return Returns(torch.arange(count), points, beams.origins, beams.directions, yes, yes, cosines, albedos)


def returned_share(context: EffectContext, before: Returns) -> float:
    return float(EFFECT.bind(context)(before).returned.double().mean())


@pytest.mark.parametrize("spread", [0.2, 0.45, 1.0])
@pytest.mark.parametrize("ratio", [0.4, 1.0, 2.5])
def test_survival_at_one_power(spread, ratio):
    """The share ratio^(1/s) / (1 + ratio^(1/s)) of echoes at ratio times the least power is detected."""
    context = context_of(LIMIT_M, spread)
    albedo = ratio * 0.9 / LIMIT_M**2 * 20.0**2 / 0.5
    expected = 1.0 / (1.0 + ratio ** (-1.0 / spread))
    found = returned_share(context, returns_of(context, albedo, 0.5))
    assert abs(found - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


def test_survival_over_albedos():
    """The mean over uniform albedos of rho / (rho + rho0), for spread 1, is 1 - rho0 ln(1 + 1 / rho0)."""
    context = context_of(LIMIT_M, 1.0)
    least = 0.9 / LIMIT_M**2 * 40.0**2
    expected = 1.0 - least * math.log(1.0 + 1.0 / least)
    found = returned_share(context, returns_of(context, range_m=40.0))
    assert abs(found - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


def test_a_sharp_limit_is_a_threshold_on_power():
    """At the stated limit an albedo of 0.9, head on, is just detected; a farther, darker or flatter one is not."""
    context = context_of(LIMIT_M, 0.0, 200)
    for albedo, cosine, range_m, expected in (
        (0.9, 1.0, 0.999 * LIMIT_M, 1.0),
        (0.9, 1.0, 1.001 * LIMIT_M, 0.0),
        (0.9, 0.25, 0.499 * LIMIT_M, 1.0),
        (0.9, 0.25, 0.501 * LIMIT_M, 0.0),
        (0.1, 1.0, 0.333 * LIMIT_M, 1.0),
        (0.1, 1.0, 0.334 * LIMIT_M, 0.0),
        (0.0, 1.0, 20.0, 0.0),
        (0.9, 0.0, 20.0, 0.0),
    ):
        assert returned_share(context, returns_of(context, albedo, cosine, range_m)) == expected


def test_no_power_at_all_is_lost_with_a_soft_limit_too():
    context = context_of(LIMIT_M, 0.45, 200)
    assert returned_share(context, returns_of(context, 0.0)) == 0.0
    assert returned_share(context, returns_of(context, 0.9, 0.0)) == 0.0


@pytest.mark.parametrize("spread", [0.0, 0.45])
@pytest.mark.parametrize("limit_m", [math.inf, None])
def test_without_a_limit_nothing_is_changed_bit_for_bit(limit_m, spread):
    context = context_of(limit_m, spread, 100)
    before = returns_of(context, 0.0)
    assert EFFECT.bind(context)(before) is before
    assert EFFECT.applicability(SceneFacts.of(context.scene), DETECTOR) is None


def test_only_rows_of_the_object_that_return_are_lost():
    context = context_of(LIMIT_M, 0.45, 600)
    pattern = torch.arange(600)
    before = dataclasses.replace(returns_of(context), on_object=pattern % 2 == 0, returned=pattern % 3 == 0)
    after = EFFECT.bind(context)(before)
    assert bool((before.returned | ~after.returned).all())
    lost = before.returned & ~after.returned
    assert bool(lost.any()) and bool(before.on_object[lost].all())
    assert all(getattr(after, name) is part for name, part in vars(before).items() if name != "returned")
    assert not EFFECT.on_scene(context)


def test_a_row_gets_its_draw_whatever_else_is_hit():
    context = context_of(LIMIT_M, 1.0, 2000)
    whole = returns_of(context, range_m=60.0)
    step = EFFECT.bind(context)
    rows = torch.arange(5, 2000, 7)
    part = Returns(**{name: None if value is None else value[rows] for name, value in vars(whole).items()})
    expected = step(whole).returned[rows]
    assert torch.equal(step(part).returned, expected)
    assert torch.equal(EFFECT.bind(context)(part).returned, expected)
    assert not torch.equal(EFFECT.bind(dataclasses.replace(context, seed=6))(part).returned, expected)


def test_what_is_lost_at_a_range_is_lost_farther_out():
    """The draw is the same at every range: an attack that moves an object sees no flicker."""
    context = context_of(LIMIT_M, 1.0, 2000)
    step = EFFECT.bind(context)
    near, far = (step(returns_of(context, range_m=r)).returned for r in (30.0, 45.0))
    assert bool((near | ~far).all()) and int(near.sum()) > int(far.sum())


@pytest.mark.parametrize("spread", [0.0, 0.45])
def test_judging_after_weather_loses_no_more_than_weather_alone(spread):
    """An echo detected through fog is also detected in clear air."""
    context = context_of(LIMIT_M, spread, 4000)
    before = returns_of(context, range_m=35.0)
    power = echo_power(before.albedo, before.cosine, before.range_m)
    weather = before.without(DetectionLoss.of(context, "fog").lost(before, power, torch.full_like(power, 0.7)))
    both = EFFECT.bind(context)(weather)
    clear = EFFECT.bind(context)(before)
    assert torch.equal(both.returned, weather.returned)
    assert int(weather.returned.sum()) < int(clear.returned.sum()) < len(before)


def test_what_stays_keeps_its_gradient():
    context = context_of(LIMIT_M, 1.0, 50)
    before = returns_of(context, range_m=60.0)
    points = before.points.clone().requires_grad_()
    after = EFFECT.bind(context)(dataclasses.replace(before, points=points))
    assert after.points is points and not after.returned.all()


def test_applies_where_the_weakest_echo_comes_near_the_limit():
    """The darkest echo, albedo cos(80 deg) / 50^2, equals 0.9 / limit^2 for a sharp limit of 569 m."""
    limit_m = OBJECT_FAR_M * math.sqrt(0.9 / (DARKEST_ALBEDO * math.cos(STEEP_RAD)))
    assert round(limit_m) == 569
    scene = context_of(None, count=50).scene

    def message(limit_m: float | None, spread: float = 0.0) -> str | None:
        soft = dataclasses.replace(scene, sensor=SensorModel(power_spread=spread))
        facts = SceneFacts.of(soft, EffectSettings(limit_range_m=limit_m))
        return EFFECT.applicability(facts, DETECTOR)

    assert message(None) is None
    assert message(1.01 * limit_m) is None
    assert "0.98 of the least power: 100 % of such echoes are lost" in (message(0.99 * limit_m) or "")
    # Spread 0.45, at the least power: half are lost; at r times the range, 1 / (1 + r^(2/0.45)).
    assert "1 of the least power: 50 % of such echoes are lost" in (message(limit_m, 0.45) or "")
    one_percent = 99.0 ** (0.45 / 2.0)
    assert message(0.99 * one_percent * limit_m, 0.45) is not None
    assert message(1.01 * one_percent * limit_m, 0.45) is None
