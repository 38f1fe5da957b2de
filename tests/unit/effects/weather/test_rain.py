"""Rain: extinction, drops in the beam and range noise against closed forms."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from weather_by_hand import COUNT, context_of, returns_of, rows_of

from shift3d.effects.base import EffectContext
from shift3d.effects.weather.precipitation import DIVERGENCE_RAD, EXIT_M, crossings, weather_range_noise_m
from shift3d.effects.weather.rain import DROP_ALBEDO, EFFECT, drops
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

BLIND = DetectorFacts("xyz")


def raining(rain_mm_h: float, sensor: SensorModel | None = None) -> EffectContext:
    return context_of(Conditions("rain", rain_mm_h=rain_mm_h, weather_in_points=False), sensor)


def expected_drops(rain_mm_h: float, power: float, range_m: float, divergence_rad: float = DIVERGENCE_RAD) -> float:
    """Count drops with echoes above a power, nearer than a range: sizes and cone by hand, integrated by QUADPACK."""
    slope = 4.1 * rain_mm_h**-0.21
    alpha = math.pi * 8000.0 / slope**3 * 1e-6

    def rate(r: float) -> float:
        seen = min(max((r - 0.9) / 0.1, 0.0), 1.0) * math.exp(-2.0 * alpha * r)
        share = power * r**2 / (DROP_ALBEDO * seen) if seen else math.inf
        width = EXIT_M + divergence_rad * r
        if share > 1.0:
            return 0.0
        return 8000.0 / slope * math.exp(-slope * 1e3 * width * math.sqrt(share)) * math.pi / 4.0 * width**2

    return quad(rate, 0.9, range_m, points=[1.0], limit=500)[0]


@pytest.mark.parametrize("rain_mm_h", [0.1, 1.0, 10.0, 100.0])
def test_extinction_is_its_closed_form(rain_mm_h):
    """1e-6 (pi / 4) 2 N0 integral of D^2 exp(-slope D) = 1e-6 pi N0 / slope^3, per metre."""
    slope = 4.1 * rain_mm_h**-0.21
    assert drops(rain_mm_h).extinction_per_m == pytest.approx(1e-6 * math.pi * 8000.0 / slope**3, rel=1e-12)


@pytest.mark.parametrize("rain_mm_h", [2.0, 10.0, 50.0])
def test_extinction_has_the_size_of_measured_ones(rain_mm_h):
    """Optical links measure 1.076 Rr^0.67 dB/km (Carbonneau and Wisely 1998): no factor of a thousand is missing."""
    measured_per_m = 1.076 * rain_mm_h**0.67 / 1000.0 / (10.0 / math.log(10.0))
    assert 0.5 < drops(rain_mm_h).extinction_per_m / measured_per_m < 2.0


def test_drops_are_large_against_the_wavelength():
    """Van de Hulst's efficiency with size parameter pi D / wavelength keeps extinction within 1 % of Q = 2."""
    slope = 4.1 * 10.0**-0.21

    def weakened(diameter_mm: float) -> float:
        size = math.pi * diameter_mm * 1e-3 / 905e-9
        phase = 2.0 * size * 0.33
        efficiency = 2.0 - 4.0 / phase * math.sin(phase) + 4.0 / phase**2 * (1.0 - math.cos(phase))
        return efficiency * diameter_mm**2 * 8000.0 * math.exp(-slope * diameter_mm)

    diameter = np.linspace(1e-4, 12.0, 200_001)
    exact = 1e-6 * math.pi / 4.0 * np.trapezoid([weakened(d) for d in diameter], diameter)
    assert exact == pytest.approx(drops(10.0).extinction_per_m, rel=0.01)


def test_the_beam_widens_by_its_angle_in_radians():
    table = crossings(drops(5.0), 2e-3)
    np.testing.assert_allclose(table.width_m(np.array([0.0, 50.0])), [EXIT_M, EXIT_M + 0.1])


@pytest.mark.parametrize("range_m", [1.5, 2.5, 4.0])
def test_in_front_of_nothing_every_drop_counts(range_m):
    """A drop is met with 1 - exp(-n V), V the beam's volume from 0.9 m on, n = N0 / slope."""
    context = raining(10.0)
    after = EFFECT.bind(context)(returns_of(context, range_m, cosine=0.0))
    width = [EXIT_M + DIVERGENCE_RAD * r for r in (0.9, range_m)]
    volume = math.pi / 12.0 * (width[1] ** 3 - width[0] ** 3) / DIVERGENCE_RAD
    expected = -math.expm1(-8000.0 / (4.1 * 10.0**-0.21) * volume)
    share = float((~after.on_object).double().mean())
    assert abs(share - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


@pytest.mark.parametrize("divergence_rad", [1e-3, 4e-3])
@pytest.mark.parametrize(("rain_mm_h", "range_m", "albedo"), [(10.0, 60.0, 0.2), (50.0, 30.0, 0.05)])
def test_drops_that_outdo_the_surface(rain_mm_h, range_m, albedo, divergence_rad):
    context = raining(rain_mm_h, SensorModel(divergence_rad=divergence_rad))
    after = EFFECT.bind(context)(returns_of(context, range_m, albedo))
    power = albedo / range_m**2 * math.exp(-2.0 * drops(rain_mm_h).extinction_per_m * range_m)
    expected = -math.expm1(-expected_drops(rain_mm_h, power, range_m, divergence_rad))
    drop = ~after.on_object
    assert abs(float(drop.double().mean()) - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)
    # Half of the drops are nearer than the range at which half of that probability is reached.
    near = float(after.range_m[drop].median())
    share = -math.expm1(-expected_drops(rain_mm_h, power, near, divergence_rad)) / expected
    assert abs(share - 0.5) < 3.0 * 0.5 / math.sqrt(int(drop.sum()))
    sent = after.albedo / after.range_m**2
    assert bool((sent[drop] >= power * (1.0 - 1e-9)).all())
    assert bool((after.range_m[drop] < range_m).all())


def test_a_drop_below_the_least_power_is_not_noticed():
    """Nothing detectable is behind the drops; the limit alone decides which drops are detected."""
    sensor = SensorModel(limit_range_m=300.0)
    context = raining(10.0, sensor)
    after = EFFECT.bind(context)(returns_of(context, 60.0, cosine=0.0))
    expected = -math.expm1(-expected_drops(10.0, 0.9 / 300.0**2, 60.0))
    share = float(after.returned.double().mean())
    assert abs(share - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)
    assert not after.on_object[after.returned].any()


def test_a_drop_is_wider_than_it_has_to_be_by_one_mean_width():
    context = raining(20.0)
    after = EFFECT.bind(context)(returns_of(context, 60.0, 0.2))
    rain, drop = drops(20.0), ~after.on_object
    at_m = after.range_m[drop].numpy()
    power = np.full(len(at_m), 0.2 / 60.0**2 * math.exp(-2.0 * rain.extinction_per_m * 60.0))
    table = crossings(rain, DIVERGENCE_RAD)
    sent = after.albedo[drop].numpy() / np.exp(-2.0 * rain.extinction_per_m * at_m) / DROP_ALBEDO
    beyond = 1e3 * table.width_m(at_m) * np.sqrt(sent) - table.least_mm(power, at_m)
    clear = at_m > 1.0  # nearer, the receiver does not see all of it
    mean = beyond[clear].mean()
    assert abs(mean - 1.0 / rain.slope) < 3.0 / rain.slope / math.sqrt(clear.sum())


def test_weaker_echoes_scatter_more_along_the_beam_alone():
    """Albedo 0.9 at half of the limit range has four times the least power, before the rain."""
    sensor = SensorModel(limit_range_m=100.0)
    context = raining(50.0, sensor)
    before = returns_of(context, 50.0, 0.9)
    after = EFFECT.bind(context)(before)
    surface = after.on_object & after.returned
    moved, count = (after.range_m - 50.0)[surface], int(surface.sum())
    transmission = math.exp(-2.0 * drops(50.0).extinction_per_m * 50.0)
    sigma = 0.09 * math.sqrt(0.5 * (1.0 / (4.0 * transmission) - 1.0 / 4.0))
    assert 1.0 / 4.0 < transmission < 0.9 and count > COUNT // 2
    assert abs(float(moved.mean())) < 3.0 * sigma / math.sqrt(count)
    assert abs(float(moved.std()) - sigma) < 3.0 * sigma / math.sqrt(2.0 * count)
    across = after.points - (after.points * before.directions).sum(-1, keepdim=True) * before.directions
    assert float(across.norm(dim=-1).max()) < 1e-12


def test_noise_that_is_added_is_bounded_and_none_where_nothing_is_lost():
    power, all_of_it = torch.tensor([0.0, 1e-5, 1.0], dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    assert weather_range_noise_m(power, all_of_it, 1e-4).tolist() == [0.0, 0.0, 0.0]
    lost = weather_range_noise_m(power, 0.0 * all_of_it, 1e-4)
    assert bool((lost <= 0.09 / math.sqrt(2.0)).all()) and float(lost[2]) == pytest.approx(
        0.09 / math.sqrt(2.0), rel=1e-4
    )


@pytest.mark.parametrize("range_m", [15.0, 30.0])
def test_beer_and_lambert_in_what_survives(range_m):
    """Albedos are uniform in [0, 1]: those above P_min R^2 exp(2 alpha R) survive a sharp limit."""
    context = raining(30.0, SensorModel(limit_range_m=40.0))
    albedo = torch.rand(COUNT, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    after = EFFECT.bind(context)(returns_of(context, range_m, albedo))
    alpha = 1e-6 * math.pi * 8000.0 / (4.1 * 30.0**-0.21) ** 3
    expected = 1.0 - 0.9 / 40.0**2 * range_m**2 * math.exp(2.0 * alpha * range_m)
    share = float((after.returned & after.on_object).double().mean())
    assert abs(share - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


def test_less_and_less_rain_comes_to_the_identity():
    context = raining(1e-9)
    before = returns_of(context, 30.0)
    after = EFFECT.bind(context)(before)
    assert bool(after.on_object.all())
    torch.testing.assert_close(after.points, before.points, rtol=0, atol=1e-12)
    torch.testing.assert_close(after.reflectance, before.reflectance, rtol=1e-4, atol=0)


def test_degenerate_rows_bring_no_nan():
    """Rows have no albedo, no range, a beam without a direction, or a surface along the beam."""
    context = raining(20.0, SensorModel(limit_range_m=90.0, power_spread=0.4))
    for known in (context, raining(20.0)):
        rows = rows_of(returns_of(known, 50.0), torch.arange(4))
        scale = torch.tensor([1.0, 0.0, 1.0, 1.0], dtype=torch.float64)
        after = EFFECT.bind(known)(
            dataclasses.replace(
                rows,
                points=rows.points * scale[:, None],
                directions=rows.directions * torch.tensor([[1.0], [1.0], [0.0], [1.0]], dtype=torch.float64),
                albedo=torch.tensor([0.0, 0.5, 0.5, 0.5], dtype=torch.float64),
                cosine=torch.tensor([1.0, 1.0, 1.0, 0.0], dtype=torch.float64),
            )
        )
        for part in (after.points, after.albedo, after.reflectance, after.cosine):
            assert bool(torch.isfinite(part).all())


def test_gradients_of_surfaces_and_drops():
    """A pose moves points along their beams: its gradient equals finite differences while no return flips."""
    context = raining(20.0)
    step, before = EFFECT.bind(context), rows_of(returns_of(context, 50.0, 0.2), torch.arange(0, COUNT, 80))
    weight = torch.rand(before.points.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2))

    def value(shift: torch.Tensor) -> torch.Tensor:
        after = step(dataclasses.replace(before, points=before.points + shift * before.directions))
        return (after.points * weight)[kept].sum()

    after = step(before)
    assert 0 < int((~after.on_object).sum()) < len(before)
    for kept in (after.on_object, ~after.on_object):
        shift = torch.zeros((), dtype=torch.float64, requires_grad=True)
        (gradient,) = torch.autograd.grad(value(shift), shift)
        if bool(after.on_object[kept].all()):
            step_m = torch.tensor(1e-6, dtype=torch.float64)
            difference = float(value(step_m) - value(-step_m)) / 2e-6
            assert float(gradient) == pytest.approx(difference, rel=1e-6)
        else:
            assert float(gradient) == 0.0


def facts_of(rain_mm_h: float, in_points: bool = True) -> SceneFacts:
    return SceneFacts("s", conditions=Conditions("rain", rain_mm_h=rain_mm_h, weather_in_points=in_points))


def test_applies_with_figures():
    reason = EFFECT.applicability(facts_of(10.0), BLIND)
    # 1 - exp(-2 * 1.555e-3 * 30) = 0.089
    assert reason == "rain 10 mm/h: 8.9 % of the light is lost at 30 m and back"


def test_does_not_apply_where_it_cannot_matter():
    assert EFFECT.applicability(facts_of(0.0), BLIND) is None
    # 0.9 % of the light at 50 m, and 1.1 %.
    assert EFFECT.applicability(facts_of(0.1), BLIND) is None
    assert EFFECT.applicability(facts_of(0.15), BLIND) is not None
