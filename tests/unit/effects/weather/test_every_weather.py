"""Common properties of fog, rain and snow: quantities that they leave alone, and the path of gradients."""

import dataclasses
from typing import Any

import pytest
import torch
from weather_by_hand import COUNT, assert_same, context_of, returns_of, rows_of

from shift3d.effects.applicability import effect_named
from shift3d.effects.base import EffectContext
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sensor import SensorModel

STRENGTH: dict[str, tuple[str, float, float]] = {
    "fog": ("visibility_m", 40.0, float("inf")),
    "rain": ("rain_mm_h", 20.0, 0.0),
    "snow": ("snow_mm_h", 2.0, 0.0),
}
"""The condition of each weather's strength, a strength, and its absence."""
weathers = pytest.mark.parametrize("name", STRENGTH)


def in_weather(name: str, strength: float, sensor: SensorModel | None = None, in_points: bool = False) -> EffectContext:
    conditions: dict[str, Any] = {STRENGTH[name][0]: strength, "weather_in_points": in_points}
    return context_of(Conditions(name, **conditions), sensor)


def step_of(name: str, context: EffectContext) -> Any:
    return effect_named(name).bind(context)


@weathers
def test_none_of_it_is_the_identity(name):
    context = in_weather(name, STRENGTH[name][2], SensorModel(limit_range_m=20.0))
    before = returns_of(context)
    assert_same(before, step_of(name, context)(before))


@weathers
def test_a_beam_gets_the_same_in_any_batch(name):
    context = in_weather(name, STRENGTH[name][1], SensorModel(limit_range_m=90.0, power_spread=0.4))
    before, rows = returns_of(context, albedo=0.3), torch.arange(3, COUNT, 7)
    step = step_of(name, context)
    assert_same(rows_of(step(before), rows), step(rows_of(before, rows)))


@weathers
def test_rows_without_a_return_stay_as_they_are(name):
    context = in_weather(name, STRENGTH[name][1], SensorModel(limit_range_m=80.0))
    before = dataclasses.replace(returns_of(context), returned=torch.zeros(COUNT, dtype=torch.bool))
    assert_same(before, step_of(name, context)(before))


@weathers
def test_points_of_weather_lie_on_their_beams_and_others_stay(name):
    context = in_weather(name, STRENGTH[name][1])
    before = returns_of(context)
    after = step_of(name, context)(before)
    of_weather = ~after.on_object
    assert 0 < int(of_weather.sum()) < COUNT and bool((after.range_m[of_weather] > 0.9 - 1e-9).all())
    offset = after.points - before.origins
    across = offset - (offset * before.directions).sum(-1, keepdim=True) * before.directions
    assert float(across[of_weather].norm(dim=-1).max()) < 1e-12
    assert torch.equal(after.points[~of_weather], before.points[~of_weather])


@weathers
def test_gradients_pass_where_the_surface_stays_and_nowhere_else(name):
    context = in_weather(name, STRENGTH[name][1])
    before = returns_of(context)
    points = before.points.clone().requires_grad_()
    after = step_of(name, context)(dataclasses.replace(before, points=points))
    assert 0 < int(after.on_object.sum()) < COUNT
    weight = torch.rand(COUNT, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    (after.points * weight).sum().backward()
    assert torch.equal(points.grad, torch.where(after.on_object[:, None], weight, 0.0))


@weathers
def test_recordings_have_their_weather_already(name):
    for in_points in (True, False):
        assert effect_named(name).on_scene(in_weather(name, STRENGTH[name][1], None, in_points)) != in_points
