"""Beams with several origins meet the object from their own origin."""

import numpy as np
import pytest
import torch
from analytic_fields import Frame, in_frame, sphere

from shift3d.effects.applicability import choose
from shift3d.effects.base import Cast, EffectContext
from shift3d.effects.chain import EffectChain
from shift3d.effects.origins import EFFECT
from shift3d.render import Beams, preset, render
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Scene

FRAME = Frame(size_m=(2.0, 2.0, 2.0), scale_m=2.5)
FIELD = in_frame(sphere(1.0), FRAME)
THETA = torch.tensor([20.0, 0.0, 0.0, 0.4, 0.0, 0.0], dtype=torch.float64)
SETTINGS = preset("reference").with_(step_m=0.02)


def scene_of(places: np.ndarray, count: int = 200) -> Scene:
    """Return beams from places (P, 3) in turns, at a wall 40 m ahead, all through a window about the object."""
    rng = np.random.default_rng(3)
    points = np.stack((np.full(count, 40.0), rng.uniform(-4, 4, count), rng.uniform(-4, 4, count)), 1)
    origins = places[np.arange(count) % len(places)].astype(np.float32)
    return Scene("several", "made", points.astype(np.float32), origins, -1.7)


TWO = np.array([[0.0, 1.5, 0.5], [1.0, -1.5, -0.25]])


def test_each_beam_meets_a_sphere_from_its_own_place() -> None:
    scene = scene_of(TWO)
    chain = EffectChain.of(["origins"], scene, FRAME, 1, EffectSettings())
    rendering = chain.render(FIELD, THETA, SETTINGS)
    start = scene.origins.astype(np.float64)
    beam = scene.points.astype(np.float64) - start
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    to_centre = THETA[:3].numpy() - start
    along = (beam * to_centre).sum(1)
    discriminant = along**2 - (to_centre**2).sum(1) + 1.0
    assert np.array_equal(rendering.hit_mask.numpy(), discriminant > 0) and 20 < rendering.object_points < 180
    hit = discriminant > 0
    depth = along[hit] - np.sqrt(discriminant[hit])
    assert np.abs(rendering.range_m.numpy()[hit] - depth).max() < 1e-8
    assert np.allclose(rendering.points.numpy()[hit], start[hit] + depth[:, None] * beam[hit], atol=1e-5)


def test_returns_stay_as_they_are_and_only_the_beams_change() -> None:
    scene = scene_of(TWO)
    context = EffectContext(scene, Beams.of_main_sensor(scene), FRAME, 1)
    cast = EFFECT.bind(context)(Cast(context.beams))
    assert torch.equal(cast.beams.points, torch.from_numpy(scene.points))
    assert torch.equal(cast.beams.origins, torch.from_numpy(scene.origins).double())
    assert not torch.equal(context.beams.origins, cast.beams.origins)
    assert cast.shift_m is None and cast.no_return is None


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.5, -1.0, 0.25)])
def test_one_place_is_the_identity_bit_for_bit(place: tuple[float, float, float]) -> None:
    scene = scene_of(np.array([place]))
    cast = Cast(Beams.of_main_sensor(scene))
    assert EFFECT.bind(EffectContext(scene, cast.beams, FRAME, 1))(cast) is cast


def test_places_that_agree_row_by_row_give_the_beams_of_one_place() -> None:
    """One place is stored in two ways, as a view and as a copy, which must be cast alike."""
    copied = scene_of(np.array([[0.5, -1.0, 0.25]]))
    rows = Beams.from_scene(copied)
    one = Beams.of_main_sensor(copied)
    assert rows.same_as(one)
    assert torch.equal(render(rows, FIELD, THETA, FRAME).points, render(one, FIELD, THETA, FRAME).points)


def test_applies_where_places_differ() -> None:
    detector = DetectorFacts("any")
    assert not choose("auto", SceneFacts.of(scene_of(TWO[:1])), detector)
    assert [choice.effect for choice in choose("auto", SceneFacts.of(scene_of(TWO)), detector)] == ["origins"]
