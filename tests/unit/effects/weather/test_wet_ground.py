"""Wet ground: Fresnel's equations, conservation of energy, and the echoes that are lost."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from analytic_fields import Frame
from scipy.integrate import quad
from weather_by_hand import assert_same

from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.physics.power import detection_probability
from shift3d.effects.weather.wet_ground import (
    EFFECT,
    GROUND_BAND_M,
    WATER_INDEX,
    fresnel_reflectance,
    internal_reflectance,
    wet_albedo,
)
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import SensorModel

COUNT = 40_000
GROUND_Z_M = -1.7
LIMIT = SensorModel(limit_range_m=100.0, power_spread=0.4)


def values(*numbers: float) -> torch.Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def context_of(
    rain_mm_h: float = 5.0, sensor: SensorModel | None = LIMIT, in_points: bool = False, range_m: float = 20.0
) -> EffectContext:
    """Return a ring of ground, walls behind it, points overhead: a third each."""
    angle = np.linspace(0.0, 2.0 * math.pi, COUNT, endpoint=False)
    z = np.choose(np.arange(COUNT) % 3, [np.full(COUNT, GROUND_Z_M), np.full(COUNT, 0.5), np.full(COUNT, 4.0)])
    points = np.stack([range_m * np.cos(angle), range_m * np.sin(angle), z], axis=1).astype(np.float32)
    conditions = Conditions("rain", rain_mm_h=rain_mm_h, weather_in_points=in_points)
    origins = np.zeros((COUNT, 3), np.float32)
    scene = Scene("street", "made", points, origins, GROUND_Z_M, conditions=conditions, sensor=sensor)
    return EffectContext(scene, Beams.from_scene(scene), Frame(), 4)


def returns_of(context: EffectContext, on_object: bool = False, albedo: float = 0.3) -> Returns:
    beams, one = context.beams, torch.ones(COUNT, dtype=torch.float64)
    there, yes = torch.full((COUNT,), on_object), torch.ones(COUNT, dtype=torch.bool)
    points = beams.points.double()
    shown = albedo * one
    return Returns(torch.arange(COUNT), points, beams.origins, beams.directions, there, yes, one, shown, shown)


def test_fresnel_head_on_along_and_at_brewsters_angle():
    n = WATER_INDEX
    head_on = ((n - 1.0) / (n + 1.0)) ** 2
    # tan(Brewster) = n: nothing is reflected in one polarisation, ((n^2 - 1) / (n^2 + 1))^2 in the other.
    brewster = 0.5 * ((n**2 - 1.0) / (n**2 + 1.0)) ** 2
    found = fresnel_reflectance(values(1.0, 1.0 / math.sqrt(1.0 + n**2), 0.0))
    torch.testing.assert_close(found, values(head_on, brewster, 1.0))


def test_light_takes_the_same_way_back():
    cosine = torch.linspace(0.01, 1.0, 50, dtype=torch.float64)
    inside = (1.0 - (1.0 - cosine**2) / WATER_INDEX**2).sqrt()
    torch.testing.assert_close(fresnel_reflectance(cosine), fresnel_reflectance(inside, 1.0 / WATER_INDEX))


def test_beyond_the_critical_angle_everything_is_reflected():
    critical = math.sqrt(1.0 - 1.0 / WATER_INDEX**2)
    beyond = torch.linspace(0.0, critical * 0.999, 20, dtype=torch.float64)
    torch.testing.assert_close(fresnel_reflectance(beyond, 1.0 / WATER_INDEX), torch.ones_like(beyond))


def mean_reflected(index: float, kink: float) -> float:
    """Compute the mean reflectance of diffuse light by QUADPACK."""
    return quad(lambda c: float(fresnel_reflectance(values(c), index)) * 2.0 * c, 0.0, 1.0, points=[kink], limit=200)[0]


def test_diffuse_light_that_stays_below():
    assert internal_reflectance() == pytest.approx(
        mean_reflected(1.0 / WATER_INDEX, math.sqrt(1.0 - WATER_INDEX**-2)), abs=1e-5
    )
    # The light that leaves per solid angle is the light that enters, over n^2.
    assert 1.0 - internal_reflectance() == pytest.approx(
        (1.0 - mean_reflected(WATER_INDEX, 0.1)) / WATER_INDEX**2, abs=1e-5
    )


@pytest.mark.parametrize("cosine", [0.05, 0.4, 1.0])
def test_a_white_ground_loses_nothing_but_what_the_water_mirrors(cosine):
    """All light that enters leaves again: over all directions, T_aw of the incident light."""
    entering = 1.0 - float(fresnel_reflectance(values(cosine)))
    towards_sensor = float(wet_albedo(values(1.0), values(cosine)))
    per_transmission = towards_sensor / entering
    total = per_transmission * (1.0 - mean_reflected(WATER_INDEX, 0.1))
    assert total == pytest.approx(entering, rel=1e-4)


def test_wet_albedo_by_hand():
    """Albedo 0.3 head on: 0.98^2 * 0.3 / 1.33^2 / (1 - 0.3 R_wa), some 60 % of the dry value; along the ground 0."""
    through = 1.0 - (0.33 / 2.33) ** 2
    expected = through**2 * 0.3 / 1.33**2 / (1.0 - 0.3 * internal_reflectance())
    torch.testing.assert_close(wet_albedo(values(0.3, 0.3, 0.0), values(1.0, 0.0, 1.0)), values(expected, 0.0, 0.0))
    assert 0.55 < expected / 0.3 < 0.65


def test_water_darkens_all_but_the_whitest_ground():
    """Light does not leave evenly: straight up, above a white ground, it exceeds a dry ground's by 3 %."""
    albedo, cosine = torch.meshgrid(
        torch.linspace(0.0, 0.95, 96, dtype=torch.float64),
        torch.linspace(0.0, 1.0, 101, dtype=torch.float64),
        indexing="ij",
    )
    assert bool((wet_albedo(albedo.flatten(), cosine.flatten()) <= albedo.flatten()).all())


def test_only_ground_is_wet_and_its_echoes_are_lost_by_their_power():
    context = context_of()
    before = returns_of(context)
    after = EFFECT.bind(context)(before)
    ground = torch.arange(COUNT) % 3 == 0
    assert torch.equal(after.points, before.points)
    assert bool(after.returned[~ground].all())
    for part in ("albedo", "reflectance"):
        assert torch.equal(vars(after)[part][~ground], vars(before)[part][~ground])
    range_m = math.hypot(20.0, GROUND_Z_M)
    wet = float(wet_albedo(values(0.3), values(-GROUND_Z_M / range_m)))
    torch.testing.assert_close(after.albedo[ground], torch.full_like(after.albedo[ground], wet), rtol=1e-6, atol=0)
    dry_kept, wet_kept = detection_probability(values(0.3, wet) / range_m**2, LIMIT).tolist()
    expected, count = wet_kept / dry_kept, int(ground.sum())
    assert 0.05 < expected < 0.95
    share = float(after.returned[ground].double().mean())
    assert abs(share - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / count)


def test_the_object_is_left_alone_with_its_gradients():
    context = context_of()
    before = returns_of(context, on_object=True)
    before = dataclasses.replace(before, points=before.points.requires_grad_())
    after = EFFECT.bind(context)(before)
    assert_same(before, after)
    assert after.points.requires_grad


@pytest.mark.parametrize(
    "context", [context_of(rain_mm_h=0.0), context_of(in_points=True)], ids=["no rain", "a recording's rain"]
)
def test_identity(context):
    before = returns_of(context)
    assert_same(before, EFFECT.bind(context)(before))


def test_what_lies_above_the_band_or_is_met_from_below_is_no_ground():
    context = context_of()
    before = returns_of(context)
    lifted = dataclasses.replace(before, points=before.points + values(0.0, 0.0, GROUND_BAND_M + 1e-6))
    assert_same(lifted, EFFECT.bind(context)(lifted))
    rising = dataclasses.replace(before, directions=before.directions * values(1.0, 1.0, -1.0))
    after = EFFECT.bind(context)(rising)
    assert torch.equal(after.albedo[::3], rising.albedo[::3])


def test_a_beam_gets_the_same_in_any_batch():
    context = context_of()
    before, rows = returns_of(context), torch.arange(3, COUNT, 7)
    part = Returns(**{name: None if value is None else value[rows] for name, value in vars(before).items()})
    whole = EFFECT.bind(context)(before)
    expected = Returns(**{name: None if value is None else value[rows] for name, value in vars(whole).items()})
    assert_same(expected, EFFECT.bind(context)(part))


def facts_of(in_points: bool = False, **known: object) -> SceneFacts:
    conditions = Conditions("rain", rain_mm_h=5.0, weather_in_points=in_points)
    return SceneFacts("s", conditions=conditions, sensor=LIMIT, **known)


def test_applies_in_rain_over_ground_in_view():
    detector = DetectorFacts("xyz")
    reason = EFFECT.applicability(facts_of(), detector)
    share = float(wet_albedo(values(0.3), values(1.73 / 20.0))) / 0.3
    assert reason == f"rain 5 mm/h wets the ground: {100.0 * share:.0f} % of its echo is left at 20 m"
    assert EFFECT.applicability(facts_of(ground_in_view=False), detector) is None
    assert EFFECT.applicability(facts_of(in_points=True), detector) is None
