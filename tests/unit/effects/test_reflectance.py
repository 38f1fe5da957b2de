"""Reflectance of the object's points: Lambert's law, and no other change."""

import dataclasses
import math

import numpy as np
import torch
from analytic_fields import Frame

from shift3d.effects.applicability import choose
from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.physics.materials import PAINT_ALBEDO
from shift3d.effects.reflectance import EFFECT
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Scene


def context_of(count: int = 300, has_reflectance: bool = True) -> EffectContext:
    rng = np.random.default_rng(2)
    points = rng.uniform(5.0, 40.0, (count, 3)).astype(np.float32)
    reflectance = rng.random(count).astype(np.float32) if has_reflectance else None
    scene = Scene("grey", "made", points, np.zeros((count, 3), np.float32), -1.7, reflectance=reflectance)
    return EffectContext(scene, Beams.from_scene(scene), Frame(), 3)


def returns_of(context: EffectContext) -> Returns:
    beams, count = context.beams, len(context.beams)
    yes = torch.ones(count, dtype=torch.bool)
    cosine, albedo = torch.rand(2, count, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    known = context.scene.reflectance
    reflectance = None if known is None else torch.from_numpy(known).double()
    points = beams.points.double()
    return Returns(torch.arange(count), points, beams.origins, beams.directions, yes, yes, cosine, albedo, reflectance)


def test_paint_by_the_angle_it_is_met_at():
    context = context_of(3)
    angle = torch.deg2rad(torch.tensor([0.0, 60.0, 90.0], dtype=torch.float64))
    before = dataclasses.replace(
        returns_of(context), cosine=angle.cos(), albedo=torch.full((3,), PAINT_ALBEDO, dtype=torch.float64)
    )
    reported = EFFECT.bind(context)(before).reflectance
    assert reported is not None
    expected = [PAINT_ALBEDO, 0.5 * PAINT_ALBEDO, 0.0]
    assert all(math.isclose(a, b, abs_tol=1e-15) for a, b in zip(reported.tolist(), expected, strict=True))


def test_it_does_not_depend_on_range():
    """Reported values are corrected for range: the same surface at twice the range reports the same."""
    context = context_of()
    before = returns_of(context)
    farther = before.moved_to(2.0 * before.range_m[before.on_object], before.on_object.nonzero().squeeze(1))
    step = EFFECT.bind(context)
    near, far = step(before).reflectance, step(farther).reflectance
    assert near is not None and far is not None and torch.equal(near, far)


def test_only_reflectance_of_the_object_changes():
    context = context_of()
    on_object = torch.arange(len(context.beams)) % 3 == 0
    before = dataclasses.replace(returns_of(context), on_object=on_object)
    after = EFFECT.bind(context)(before)
    assert before.reflectance is not None and after.reflectance is not None
    assert torch.equal(after.reflectance[~on_object], before.reflectance[~on_object])
    assert torch.equal(after.reflectance[on_object], (before.albedo * before.cosine)[on_object])
    assert bool(((after.reflectance >= 0.0) & (after.reflectance <= 1.0)).all())
    for name in ("row", "points", "origins", "directions", "on_object", "returned", "cosine", "albedo"):
        assert getattr(after, name) is getattr(before, name)
    assert not EFFECT.on_scene(context)


def test_no_object_is_the_identity_bit_for_bit():
    context = context_of()
    before = dataclasses.replace(returns_of(context), on_object=torch.zeros(300, dtype=torch.bool))
    after = EFFECT.bind(context)(before)
    assert before.reflectance is not None and after.reflectance is not None
    assert torch.equal(after.reflectance, before.reflectance)


def test_a_scene_without_reflectance_gets_none():
    context = context_of(has_reflectance=False)
    assert EFFECT.bind(context)(returns_of(context)).reflectance is None


def test_a_row_reports_the_same_whatever_else_is_hit():
    context = context_of()
    whole, rows = returns_of(context), torch.tensor([0, 7, 200])
    part = Returns(**{name: value[rows] for name, value in vars(whole).items()})
    step = EFFECT.bind(context)
    all_rows, some = step(whole).reflectance, step(part).reflectance
    assert all_rows is not None and some is not None and torch.equal(some, all_rows[rows])


def test_it_carries_no_gradient():
    context = context_of()
    before = returns_of(context)
    before = dataclasses.replace(before, cosine=before.cosine.requires_grad_())
    reported = EFFECT.bind(context)(before).reflectance
    assert reported is not None and not reported.requires_grad


def test_applies_where_a_detector_reads_what_the_scene_has():
    with_it, without = (SceneFacts.of(context_of(20, known).scene) for known in (True, False))
    reader, coordinates = DetectorFacts("sst", reads_reflectance=True), DetectorFacts("pointpillars")
    (reason,) = (choice.reason for choice in choose("auto", with_it, reader) if choice.effect == "reflectance")
    assert "sst" in reason
    for scene, detector in ((with_it, coordinates), (without, reader)):
        assert all(choice.effect != "reflectance" for choice in choose("auto", scene, detector))
