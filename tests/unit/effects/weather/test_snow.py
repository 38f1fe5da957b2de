"""Snow: extinction and flakes in the beam against closed forms, and all weather together."""

import math

import pytest
import torch
from scipy.integrate import quad
from weather_by_hand import COUNT, context_of, returns_of

from shift3d.effects.applicability import NEEDS, effect_named
from shift3d.effects.base import EffectContext
from shift3d.effects.weather.fog import extinction_per_m
from shift3d.effects.weather.precipitation import DIVERGENCE_RAD, EXIT_M
from shift3d.effects.weather.rain import drops
from shift3d.effects.weather.snow import EFFECT, FLAKE_ALBEDO, FLAKE_WIDTH, flakes
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

BLIND = DetectorFacts("xyz")


def snowing(snow_mm_h: float, sensor: SensorModel | None = None) -> EffectContext:
    return context_of(Conditions("snow", snow_mm_h=snow_mm_h, weather_in_points=False), sensor)


def extinction(snow_mm_h: float) -> float:
    """Return 1e-6 (pi / 4) 2 N0 integral of (w D)^2 exp(-lambda D), D of the melted drop, w flake width over D."""
    return 1e-6 * math.pi * 3800.0 * snow_mm_h**-0.87 * FLAKE_WIDTH**2 / (2.55 * snow_mm_h**-0.48) ** 3


@pytest.mark.parametrize("snow_mm_h", [0.1, 1.0, 5.0])
def test_extinction_is_its_closed_form(snow_mm_h):
    assert flakes(snow_mm_h).extinction_per_m == pytest.approx(extinction(snow_mm_h), rel=1e-12)


def test_visibility_in_moderate_snow():
    """Weather services define moderate snow by visibilities of 1 km to 0.5 km, and melted rates of 1 to 2.5 mm/h."""
    for rate, visibility_m in ((1.0, 1000.0), (2.5, 500.0)):
        assert math.log(20.0) / flakes(rate).extinction_per_m == pytest.approx(visibility_m, rel=0.25)


def test_as_many_flakes_as_gunn_and_marshall_counted():
    """Gunn and Marshall (1958) counted 3.8e3 R^-0.87 per m^3 and mm of melted diameter, slope 25.5 R^-0.48 per cm."""
    for rate, density, slope in ((1.0, 3800.0, 2.55), (2.0, 2079.2, 1.8283), (0.5, 6945.1, 3.5566)):
        found = flakes(rate)
        assert found.density * FLAKE_WIDTH == pytest.approx(density, rel=1e-4)
        assert found.slope * FLAKE_WIDTH == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("snow_mm_h", [0.5, 1.0, 2.5])
def test_what_falls_is_the_rate(snow_mm_h):
    """All flakes, falling at 1 m/s, carry this rate: pi density / slope^4 in mm^3 per m^3 of melted diameters."""
    found = flakes(snow_mm_h)
    density, slope = found.density * FLAKE_WIDTH, found.slope * FLAKE_WIDTH
    falls_mm_h = math.pi * density / slope**4 * 1.0 * 3600.0 / 1e6
    assert falls_mm_h == pytest.approx(snow_mm_h, rel=0.1)


def test_flakes_are_as_many_as_the_drops_they_melt_to():
    assert flakes(1.0).number_density_per_m3 == pytest.approx(3800.0 / 2.55)


@pytest.mark.parametrize("range_m", [1.5, 2.5, 4.0])
def test_in_front_of_nothing_every_flake_counts(range_m):
    context = snowing(1.0)
    after = EFFECT.bind(context)(returns_of(context, range_m, cosine=0.0))
    width = [EXIT_M + DIVERGENCE_RAD * r for r in (0.9, range_m)]
    volume = math.pi / 12.0 * (width[1] ** 3 - width[0] ** 3) / DIVERGENCE_RAD
    expected = -math.expm1(-3800.0 / 2.55 * volume)
    share = float((~after.on_object).double().mean())
    assert abs(share - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


@pytest.mark.parametrize(("snow_mm_h", "range_m", "albedo"), [(0.3, 20.0, 0.4), (2.0, 40.0, 0.1)])
def test_flakes_that_cover_enough_of_the_beam(snow_mm_h, range_m, albedo):
    context = snowing(snow_mm_h)
    after = EFFECT.bind(context)(returns_of(context, range_m, albedo))
    alpha, slope = extinction(snow_mm_h), 2.55 * snow_mm_h**-0.48
    power = albedo / range_m**2 * math.exp(-2.0 * alpha * range_m)

    def rate(r: float) -> float:
        seen = min(max((r - 0.9) / 0.1, 0.0), 1.0) * math.exp(-2.0 * alpha * r)
        width = EXIT_M + DIVERGENCE_RAD * r
        share = power * r**2 / (FLAKE_ALBEDO * seen) if seen else math.inf
        if share > 1.0:
            return 0.0
        melted_mm = 1e3 * width * math.sqrt(share) / FLAKE_WIDTH
        return 3800.0 * snow_mm_h**-0.87 / slope * math.exp(-slope * melted_mm) * math.pi / 4.0 * width**2

    expected = -math.expm1(-quad(rate, 0.9, range_m, points=[1.0], limit=500)[0])
    flake = ~after.on_object
    assert abs(float(flake.double().mean()) - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)
    near = float(after.range_m[flake].median())
    share = -math.expm1(-quad(rate, 0.9, near, points=[min(1.0, near)], limit=500)[0]) / expected
    assert abs(share - 0.5) < 3.0 * 0.5 / math.sqrt(int(flake.sum()))
    assert torch.equal(after.points[~flake], returns_of(context, range_m).points[~flake])


@pytest.mark.parametrize("range_m", [10.0, 20.0])
def test_beer_and_lambert_in_what_survives(range_m):
    """Albedos are uniform in [0, 1]; the beam is narrow and the sensor poor, so that no flake intervenes."""
    context = snowing(2.0, SensorModel(limit_range_m=25.0, divergence_rad=1e-5))
    albedo = torch.rand(COUNT, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    after = EFFECT.bind(context)(returns_of(context, range_m, albedo))
    alone = after.on_object  # neither it nor a flake's draw depends on the albedo of lost returns
    noticed = albedo >= 0.9 / 25.0**2 * range_m**2 * math.exp(2.0 * extinction(2.0) * range_m)
    assert torch.equal(after.returned[alone], noticed[alone])
    expected = 1.0 - 0.9 / 25.0**2 * range_m**2 * math.exp(2.0 * extinction(2.0) * range_m)
    assert abs(float(noticed.double().mean()) - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


def test_extinctions_of_all_weather_add_up():
    """Fog, rain and snow in turn leave exp(-2 (sum of alphas) R) of a surface's echo."""
    conditions = Conditions("fog", rain_mm_h=5.0, snow_mm_h=0.3, visibility_m=300.0, weather_in_points=False)
    context = context_of(conditions)
    before = returns_of(context, 15.0, 0.9)
    after = before
    names = [name for name in NEEDS if name in ("snow", "rain", "fog")]
    assert names == ["fog", "rain", "snow"]
    for name in names:
        after = effect_named(name).bind(context)(after)  # type: ignore[operator]
    surface = after.on_object & after.returned
    assert float(surface.double().mean()) > 0.5
    total = extinction_per_m(300.0) + drops(5.0).extinction_per_m + extinction(0.3)
    # Snow sees the range that rain has scattered by 2 %.
    expected = torch.full((COUNT,), 0.5 * math.exp(-2.0 * total * 15.0), dtype=torch.float64)
    torch.testing.assert_close(after.reflectance[surface], expected[surface], rtol=5e-3, atol=0)


def test_all_weather_loses_by_the_sum_of_extinctions():
    """A sharp limit, applied by each in turn, loses on the object the same echoes as the whole extinction at once."""
    conditions = Conditions("fog", snow_mm_h=0.5, visibility_m=200.0, weather_in_points=False)
    context = context_of(conditions, SensorModel(limit_range_m=40.0, divergence_rad=1e-5))
    albedo = torch.rand(COUNT, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    after = returns_of(context, 15.0, albedo)
    for name in ("fog", "snow"):
        after = effect_named(name).bind(context)(after)  # type: ignore[operator]
    total = extinction_per_m(200.0) + extinction(0.5)
    noticed = albedo * math.exp(-2.0 * total * 15.0) / 15.0**2 >= 0.9 / 40.0**2
    assert torch.equal(after.returned[after.on_object], noticed[after.on_object])


def facts_of(snow_mm_h: float) -> SceneFacts:
    return SceneFacts("s", conditions=Conditions("snow", snow_mm_h=snow_mm_h))


def test_applies_with_figures():
    reason = EFFECT.applicability(facts_of(1.0), BLIND)
    # 1 - exp(-2 * 3.175e-3 * 30) = 0.173
    assert reason == "snow 1 mm/h: 17 % of the light is lost at 30 m and back"
    assert EFFECT.applicability(facts_of(0.0), BLIND) is None
    # 2 * 50 m * 3.175e-3 Rr^0.57 = 1 % at 0.0023 mm/h.
    assert EFFECT.applicability(facts_of(0.001), BLIND) is None
