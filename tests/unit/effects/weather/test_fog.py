"""Fog: Beer and Lambert, its two limits, and its own echo against the integral of the equations."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from weather_by_hand import COUNT, context_of, returns_of

from shift3d.effects.base import EffectContext
from shift3d.effects.weather.fog import EFFECT, PULSE_S, backscatter_per_m, extinction_per_m, fog_echo_table
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

BLIND = DetectorFacts("xyz")


def foggy(visibility_m: float, sensor: SensorModel | None = None) -> EffectContext:
    return context_of(Conditions("fog", visibility_m=visibility_m, weather_in_points=False), sensor)


def echo_by_integration(visibility_m: float, range_m: float) -> tuple[float, float]:
    """Return the fog's echo over the surface's in clear air, and R of its maximum: the equation, term by term."""
    alpha, beta = math.log(20.0) / visibility_m, 0.046 / visibility_m
    t = np.linspace(0.0, 2.0 * PULSE_S, 8001)
    best, best_at = 0.0, 0.0
    for received in np.arange(3.5, 7.5, 0.01):
        r = received - 299_792_458.0 * t / 2.0
        seen = np.clip((r - 0.9) / 0.1, 0.0, 1.0) * (r < range_m)
        r = np.maximum(r, 0.5)
        pulse = np.sin(math.pi * t / (2.0 * PULSE_S)) ** 2
        value = float(np.trapezoid(pulse * np.exp(-2.0 * alpha * r) / r**2 * seen, t))
        if value > best:
            best, best_at = value, received
    return range_m**2 * beta / (1e-6 / math.pi) * best, best_at


def test_at_the_optical_range_five_percent_is_left():
    assert math.exp(-extinction_per_m(50.0) * 50.0) == pytest.approx(0.05)
    assert backscatter_per_m(50.0) == pytest.approx(9.2e-4)


@pytest.mark.parametrize(("visibility_m", "range_m"), [(50.0, 30.0), (50.0, 1.5), (10.0, 3.0), (200.0, 80.0)])
def test_echo_of_fog_is_the_integral(visibility_m, range_m):
    ratio, received = echo_by_integration(visibility_m, range_m)
    log_ratio, reported = fog_echo_table(extinction_per_m(visibility_m), backscatter_per_m(visibility_m)).at(
        np.array([range_m])
    )
    assert math.exp(log_ratio[0]) == pytest.approx(ratio, rel=2e-3)
    # A surface's maximum, too, is received half a pulse behind the surface.
    assert reported[0] == pytest.approx(received - 299_792_458.0 * PULSE_S / 2.0, abs=0.015)


def test_one_table_serves_a_process():
    first = fog_echo_table(extinction_per_m(70.0), backscatter_per_m(70.0))
    EFFECT.bind(foggy(70.0))
    assert fog_echo_table(extinction_per_m(70.0), backscatter_per_m(70.0)) is first


def test_the_echo_of_fog_never_lies_behind_the_surface():
    range_m = np.geomspace(0.9001, 200.0, 3000)
    for visibility_m in (1e-3, 1.0, 50.0, 1e5):
        reported = fog_echo_table(extinction_per_m(visibility_m), backscatter_per_m(visibility_m)).at(range_m)[1]
        assert (reported >= 0.9).all()
        assert (reported <= range_m * (1.0 + 1e-3)).all()


def test_thinner_and_thinner_fog_comes_to_the_identity():
    context = foggy(1e9)
    before = returns_of(context)
    after = EFFECT.bind(context)(before)
    assert torch.equal(after.points, before.points)
    assert bool((after.on_object & after.returned).all())
    torch.testing.assert_close(after.reflectance, before.reflectance, rtol=1e-6, atol=0)


@pytest.mark.parametrize("visibility_m", [0.5, 0.1, 1e-3, 1e-6])
def test_dense_fog_is_seen_close_to_the_sensor(visibility_m):
    context = foggy(visibility_m, SensorModel(limit_range_m=120.0, power_spread=0.4))
    before = returns_of(context)
    after = EFFECT.bind(context)(before)
    far = before.range_m > 2.5
    assert bool(after.returned[far].all())
    assert not after.on_object[far].any()
    assert bool(((after.range_m[far] > 0.9 - 1e-9) & (after.range_m[far] < 1.1)).all())
    for part in (after.points, after.albedo, after.reflectance, after.cosine):
        assert bool(torch.isfinite(part).all())


def test_beer_and_lambert_in_what_surfaces_report():
    context = foggy(200.0)
    before = returns_of(context)
    after = EFFECT.bind(context)(before)
    surface = after.on_object
    expected = 0.5 * torch.exp(-2.0 * extinction_per_m(200.0) * before.range_m)
    torch.testing.assert_close(after.reflectance[surface], expected[surface])
    torch.testing.assert_close(after.albedo[surface], expected[surface])


@pytest.mark.parametrize("range_m", [10.0, 20.0, 30.0])
def test_beer_and_lambert_in_what_survives(range_m):
    """Albedos are uniform in [0, 1]: those above P_min R^2 exp(2 alpha R) survive a sharp limit."""
    context = foggy(100.0, SensorModel(limit_range_m=100.0))
    albedo = torch.rand(COUNT, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    after = EFFECT.bind(context)(returns_of(context, range_m, albedo))
    expected = 1.0 - 9e-5 * range_m**2 * math.exp(2.0 * math.log(20.0) / 100.0 * range_m)
    share = float(after.returned.double().mean())
    assert abs(share - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


def test_which_echo_wins_does_not_depend_on_the_scale_of_reflectance():
    context = foggy(40.0)
    bright = returns_of(context)
    dark = dataclasses.replace(bright, albedo=bright.albedo / 255.0, reflectance=bright.reflectance / 255.0)
    step = EFFECT.bind(context)
    assert torch.equal(step(bright).points, step(dark).points)


def facts_of(visibility_m: float, **known: object) -> SceneFacts:
    return SceneFacts("s", conditions=Conditions("fog", visibility_m=visibility_m), **known)


def test_applies_with_figures():
    reason = EFFECT.applicability(facts_of(50.0), BLIND)
    # 1 - exp(-2 * 30 ln 20 / 50) = 0.973
    assert reason is not None
    assert "visibility 50 m: 97 % of the light is lost at 30 m and back" in reason


def test_does_not_apply_where_it_cannot_matter():
    limited = SensorModel(limit_range_m=100.0)
    assert EFFECT.applicability(facts_of(math.inf, sensor=limited), BLIND) is None
    # 2 * 50 ln 20 / MOR = 1 % at 30 km.
    assert EFFECT.applicability(facts_of(31_000.0, sensor=limited), BLIND) is None
    assert EFFECT.applicability(facts_of(29_000.0, sensor=limited), BLIND) is not None
    # At 500 m fog outshines no surface within 50 m: only a reader of reflectance, or a known limit, would notice.
    assert EFFECT.applicability(facts_of(500.0), BLIND) is None
    reader = DetectorFacts("xyzi", reads_reflectance=True)
    assert EFFECT.applicability(facts_of(500.0, has_reflectance=True), reader) is not None
