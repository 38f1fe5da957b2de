"""Later returns behind an inserted object: by hand, and against a plain double loop."""

import dataclasses

import numpy as np
import pytest
import torch
from analytic_fields import Frame, box, in_frame

from shift3d.effects.applicability import NEEDS
from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.chain import NO_RETURN_M, EffectChain
from shift3d.effects.second_returns import EFFECT
from shift3d.render import preset
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Scene


def scene_of(number, pixel, points=None, origins=None) -> Scene:
    count = len(number)
    points = np.full((count, 3), 10.0) if points is None else points
    return Scene(
        "two returns",
        "made",
        np.asarray(points, np.float32),
        np.zeros((count, 3), np.float32) if origins is None else np.asarray(origins, np.float32),
        -1.7,
        return_number=np.asarray(number, np.uint8),
        range_image_index=np.asarray(pixel, np.int32),
    )


def context_of(scene: Scene) -> EffectContext:
    return EffectContext(scene, Beams.from_scene(scene), Frame(), 3)


def returns_of(context: EffectContext, on_object, rows=None) -> Returns:
    beams = context.beams
    row = torch.arange(len(beams)) if rows is None else rows
    yes, half = torch.ones(len(row), dtype=torch.bool), torch.full((len(row),), 0.5, dtype=torch.float64)
    on = torch.as_tensor(on_object)[row]
    return Returns(
        row, beams.points[row].double(), beams.origins[row], beams.directions[row], on, yes, half, half, half
    )


def kept(scene: Scene, on_object) -> list[bool]:
    context = context_of(scene)
    return EFFECT.bind(context)(returns_of(context, on_object)).returned.tolist()


SAME, OTHER = (3, 70), (70, 3)


@pytest.mark.parametrize(
    ("number", "pixel", "on_object", "expected"),
    [
        ([0, 1], [SAME, SAME], [True, True], [True, False]),  # object in front of both
        ([1, 0], [SAME, SAME], [True, True], [False, True]),  # whatever the order of rows
        ([0, 1], [SAME, SAME], [False, True], [True, True]),  # object between them: the second stays, moved
        ([0, 1], [SAME, SAME], [True, False], [True, True]),  # not an object's row: left alone
        ([0, 1], [SAME, OTHER], [True, True], [True, True]),  # two beams
        ([1, 1], [SAME, OTHER], [True, True], [True, True]),  # first returns that the scene lacks
        ([0, 1, 2], [SAME] * 3, [True] * 3, [True, False, False]),
        ([0, 1, 2], [SAME] * 3, [False, True, True], [True, True, False]),
        ([0, 0], [SAME, SAME], [True, True], [True, True]),  # neither comes after the other
        ([0, 1], [(-1, -1)] * 2, [True, True], [True, True]),  # no pixel: no key for pairing
    ],
)
def test_beams_by_hand(number, pixel, on_object, expected):
    assert kept(scene_of(number, pixel), on_object) == expected


def test_pixels_of_two_sensors_are_different_beams():
    number, pixel, on_object = [0, 1, 0, 1], [SAME] * 4, [True, False, False, True]
    points = [(10, 0, 0)] * 4
    two = scene_of(number, pixel, points, [(0, 0, 2), (0, 0, 2), (1, 0, 1), (1, 0, 1)])
    assert kept(two, on_object) == [True, True, True, True]
    one = scene_of([*number[:2], 1], pixel[:3], points[:3])
    assert kept(one, [True, False, True]) == [True, True, False]


def random_scene(count: int, seed: int) -> Scene:
    """Return up to three returns per beam, some missing, rows in any order, three sensors."""
    rng = np.random.default_rng(seed)
    beams = np.stack((rng.integers(0, 40, count), rng.integers(0, 30, count)), 1)
    sensor = rng.integers(0, 3, count)
    rows = {(*beams[i], sensor[i], n) for i in range(count) for n in range(3) if rng.random() < 0.6}
    table = np.array(sorted(rows))[rng.permutation(len(rows))]
    points = rng.uniform(5.0, 40.0, (len(table), 3))
    origins = np.array([(0, 0, 2), (1, 0, 1), (1, -0.5, 1)])[table[:, 2]]
    return scene_of(table[:, 3], table[:, :2], points, origins)


def test_against_a_plain_double_loop():
    for seed in range(3):
        scene = random_scene(250, seed)
        on_object = np.random.default_rng(seed + 10).random(len(scene.points)) < 0.5
        assert scene.return_number is not None and scene.range_image_index is not None
        expected = []
        for i in range(len(scene.points)):
            stopped = any(
                on_object[j]
                and scene.return_number[j] < scene.return_number[i]
                and (scene.range_image_index[j] == scene.range_image_index[i]).all()
                and (scene.origins[j] == scene.origins[i]).all()
                for j in range(len(scene.points))
            )
            expected.append(not (on_object[i] and stopped))
        assert not all(expected) and kept(scene, on_object) == expected


def test_whole_beams_come_out_the_same_whatever_else_is_hit():
    scene = random_scene(300, 5)
    context = context_of(scene)
    on_object = np.random.default_rng(6).random(len(scene.points)) < 0.5
    step = EFFECT.bind(context)
    whole = step(returns_of(context, on_object)).returned
    # Rows off the object stop nothing: the chain, too, passes the object's rows alone.
    rows = torch.from_numpy(np.flatnonzero(on_object))
    assert torch.equal(step(returns_of(context, on_object, rows)).returned, whole[rows])
    assert scene.range_image_index is not None
    rows = torch.from_numpy(np.flatnonzero(scene.range_image_index[:, 0] < 20))
    assert torch.equal(step(returns_of(context, on_object, rows)).returned, whole[rows])


def test_nothing_but_returned_is_changed_and_nothing_where_no_beam_has_two():
    scene = random_scene(100, 7)
    context = context_of(scene)
    before = returns_of(context, np.ones(len(scene.points), bool))
    after = EFFECT.bind(context)(before)
    assert all(getattr(after, name) is part for name, part in vars(before).items() if name != "returned")
    first = scene_of([0, 0], [SAME, OTHER])
    before = returns_of(context_of(first), [True, True])
    assert EFFECT.bind(context_of(first))(before) is before
    bare = dataclasses.replace(first, return_number=None)
    assert EFFECT.bind(context_of(bare))(before) is before
    assert not EFFECT.on_scene(context)


def test_what_is_gone_already_stays_gone_and_still_stops_the_beam():
    scene = scene_of([0, 1], [SAME, SAME])
    context = context_of(scene)
    before = dataclasses.replace(returns_of(context, [True, True]), returned=torch.tensor([False, True]))
    assert EFFECT.bind(context)(before).returned.tolist() == [False, False]


def test_one_return_a_beam_from_an_inserted_box():
    """A box 4 m thick is around x = 20 m. First returns are at 16 or 40 m, second ones at 45 m, near the x axis.

    Points that stay on the box follow its pose: dx / dx_object = 1, straight ahead.
    """
    frame = Frame(size_m=(4.0, 2.0, 2.0))
    direction = np.array([[1.0, 0.0, 0.0], [1.0, 0.01, 0.0], [1.0, 0.5, 0.0]])
    points = np.concatenate([direction * r for r in (np.array([[40.0], [16.0], [40.0]]), 45.0)])
    scene = scene_of([0, 0, 0, 1, 1, 1], [(0, 0), (0, 1), (0, 2)] * 2, points)
    chain = EffectChain.of(["second_returns"], scene, frame, 3, EffectSettings())
    theta = torch.tensor([20.0, 0, 0, 0, 0, 0], dtype=torch.float64, requires_grad=True)
    found = chain.render(in_frame(box((2.0, 1.0, 1.0)), frame), theta, preset("reference"))
    assert found.hit_mask.tolist() == [True, False, False, False, True, False]
    assert found.returned is not None and found.returned.tolist() == [True, True, True, False, True, True]
    x = found.points[:, 0].detach()
    assert x[:3].tolist() == pytest.approx([18.0, 16.0, 40.0], abs=1e-5)
    assert float(found.points[3].detach().norm()) == pytest.approx(NO_RETURN_M)
    assert float(x[4]) == pytest.approx(18.0, abs=1e-5) and torch.equal(found.points[5], torch.tensor(scene.points[5]))
    (gradient,) = torch.autograd.grad(found.points[0, 0] + found.points[3, 0], theta)
    assert float(gradient[0]) == pytest.approx(1.0, abs=1e-6)


def test_applies_where_beams_have_more_than_one_return():
    two = scene_of([0, 1], [SAME, SAME])
    detector = DetectorFacts("reader")
    assert "2 returns" in (EFFECT.applicability(SceneFacts.of(two), detector) or "")
    one = dataclasses.replace(two, return_number=np.zeros(2, np.uint8))
    for scene in (one, dataclasses.replace(two, return_number=None), dataclasses.replace(two, range_image_index=None)):
        assert not NEEDS["second_returns"].present(SceneFacts.of(scene))
