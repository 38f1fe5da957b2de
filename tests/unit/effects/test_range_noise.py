"""Spread and direction of range noise against closed forms."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from analytic_fields import Frame

from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.range_noise import EFFECT
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Scene
from shift3d.scenes.sensor import SensorModel

SIGMA_M = 0.03
COUNT = 20_000


def context_of(sigma_m: float | None, count: int = COUNT, seed: int = 5) -> EffectContext:
    rng = np.random.default_rng(1)
    points = rng.uniform(-40.0, 40.0, (count, 3)).astype(np.float32)
    origins = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
    scene = Scene("noisy", "made", points, origins, -1.7, sensor=SensorModel(range_noise_m=sigma_m))
    return EffectContext(scene, Beams.from_scene(scene), Frame(), seed)


def returns_of(context: EffectContext, rows: torch.Tensor | None = None) -> Returns:
    """Return rows halfway along their beams, on the object."""
    beams = context.beams
    row = torch.arange(len(beams)) if rows is None else rows
    origins, directions = beams.origins[row], beams.directions[row]
    points = origins + 0.5 * beams.ranges_m[row, None] * directions
    yes, half = torch.ones(len(row), dtype=torch.bool), torch.full((len(row),), 0.5, dtype=torch.float64)
    return Returns(row, points, origins, directions, yes, yes, half, half, half)


def test_spread_along_the_beam_and_none_across():
    context = context_of(SIGMA_M)
    before = returns_of(context)
    after = EFFECT.bind(context)(before)
    along = (after.range_m - before.range_m) / SIGMA_M
    # Standard errors of mean, standard deviation and kurtosis of normal draws.
    assert abs(float(along.mean())) < 3.0 / math.sqrt(COUNT)
    assert abs(float(along.std()) - 1.0) < 3.0 / math.sqrt(2.0 * COUNT)
    assert abs(float((along**4).mean()) - 3.0) < 3.0 * math.sqrt(96.0 / COUNT)
    offset = after.points - before.origins
    across = offset - (offset * before.directions).sum(-1, keepdim=True) * before.directions
    assert bool((across.norm(dim=-1) <= 1e-12 * before.range_m.clamp_min(1.0)).all())


def test_the_spread_is_that_of_each_range_near_and_far():
    context = context_of(SIGMA_M)
    before = returns_of(context)
    along = EFFECT.bind(context)(before).range_m - before.range_m
    near = before.range_m < before.range_m.median()
    for part in (along[near], along[~near]):
        assert abs(float(part.std()) / SIGMA_M - 1.0) < 3.0 / math.sqrt(2.0 * len(part))


def test_no_return_lies_behind_its_sensor():
    """The largest noise that a sensor may state exceeds some of the ranges."""
    context = context_of(10.0, 2_000)
    before = returns_of(context)
    after = EFFECT.bind(context)(before)
    noise_m = 10.0 * torch.from_numpy(context.draws("range_noise").standard_normal(2_000))
    ahead = before.range_m + noise_m > 0.0
    assert int((~ahead).sum()) > 0 and torch.equal(after.returned, ahead)
    assert bool((after.range_m[after.returned] > 0.0).all())


@pytest.mark.parametrize("sigma_m", [0.0, None])
def test_no_noise_is_the_identity_bit_for_bit(sigma_m):
    context = context_of(sigma_m, 50)
    before = returns_of(context)
    assert EFFECT.bind(context)(before).points is before.points


def test_a_scene_without_a_sensor_model_is_left_alone():
    context = context_of(SIGMA_M, 50)
    bare = dataclasses.replace(context, scene=dataclasses.replace(context.scene, sensor=None))
    before = returns_of(bare)
    assert EFFECT.bind(bare)(before).points is before.points


def test_only_points_of_the_object_that_come_back_are_changed():
    context = context_of(SIGMA_M, 400)
    pattern = torch.arange(400)
    before = dataclasses.replace(returns_of(context), on_object=pattern % 2 == 0, returned=pattern % 3 == 0)
    after = EFFECT.bind(context)(before)
    moved = (after.points != before.points).any(-1)
    assert torch.equal(moved, pattern % 6 == 0)
    for name in ("row", "origins", "directions", "on_object", "returned", "cosine", "albedo", "reflectance"):
        assert getattr(after, name) is getattr(before, name)
    assert not EFFECT.on_scene(context)


def test_a_row_gets_its_draw_whatever_else_is_hit():
    context = context_of(SIGMA_M, 500)
    rows = torch.tensor([3, 77, 78, 300, 499])
    step = EFFECT.bind(context)
    whole = step(returns_of(context)).points[rows]
    assert torch.equal(step(returns_of(context, rows)).points, whole)
    assert torch.equal(EFFECT.bind(context)(returns_of(context, rows)).points, whole)
    other = dataclasses.replace(context, seed=6)
    assert not torch.equal(EFFECT.bind(other)(returns_of(context, rows)).points, whole)


def test_derivatives_are_those_of_the_exact_point():
    """The references are central differences of range along the beam, and of the point in any direction."""
    context = context_of(SIGMA_M, 6)
    step, base = EFFECT.bind(context), returns_of(context)

    def noisy(points: torch.Tensor) -> torch.Tensor:
        return step(dataclasses.replace(base, points=points)).points

    points = base.points.clone().requires_grad_()
    assert torch.autograd.gradcheck(noisy, (points,), eps=1e-6, atol=1e-8)
    (gradient,) = torch.autograd.grad((noisy(points) * base.directions).sum(), points)
    assert torch.allclose(gradient, base.directions, rtol=0, atol=1e-15)
    h = 1e-4
    for sign in (-1.0, 1.0):
        shifted = noisy(base.points + sign * h * base.directions) - noisy(base.points)
        assert torch.allclose(
            (shifted * base.directions).sum(-1), torch.tensor(sign * h, dtype=torch.float64), rtol=0, atol=1e-12
        )


def test_applies_where_the_sensor_states_a_noise_that_points_can_hold():
    scene = context_of(None, 50).scene
    for sigma_m, reason in ((None, None), (1e-7, None), (0.015, "15 mm"), (1.5, "1.5 m")):
        facts = SceneFacts.of(scene, EffectSettings(range_noise_m=sigma_m))
        message = EFFECT.applicability(facts, DetectorFacts("reader"))
        assert message is None if reason is None else message is not None and reason in message
