"""Displacement by firing time against closed forms."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from analytic_fields import Frame, box, in_frame

from shift3d.effects.base import Cast, EffectContext
from shift3d.effects.chain import EffectChain
from shift3d.effects.rolling_shutter import ASSUMED_NOISE_M, EFFECT, relative_velocity
from shift3d.render import Beams, preset
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import SensorModel

FRAME = Frame(size_m=(1.0, 3.0, 3.0), scale_m=2.5)
PLATE = in_frame(box((0.5, 1.5, 1.5)), FRAME)
THETA = torch.tensor([20.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
SETTINGS = preset("reference").with_(step_m=0.02)
DETECTOR = DetectorFacts("any")
COUNT, SCAN_S = 400, 0.1


def scene_of(conditions: Conditions | None = None, sensor: SensorModel | None = None) -> Scene:
    """Return beams at a wall 40 m ahead, which fire in a mixed order."""
    rng = np.random.default_rng(8)
    points = np.stack((np.full(COUNT, 40.0), rng.uniform(-5, 5, COUNT), rng.uniform(-2, 2, COUNT)), 1)
    times = rng.permutation(np.linspace(0.0, SCAN_S, COUNT)).astype(np.float32)
    origins = np.broadcast_to(np.zeros((1, 3), np.float32), (COUNT, 3))
    return Scene(
        "moving", "made", points.astype(np.float32), origins, -1.7, time_s=times,
        conditions=conditions or Conditions(), sensor=sensor,
    )  # fmt: skip


def chain_of(scene: Scene, speed: float, heading: float = 0.0) -> EffectChain:
    settings = EffectSettings(object_speed_m_s=speed)
    return EffectChain.of(["rolling_shutter"], scene, FRAME, 1, settings, heading)


def test_a_plate_that_drives_away_is_met_where_it_is_when_each_beam_fires() -> None:
    scene = scene_of()
    rendering = chain_of(scene, 12.0).render(PLATE, THETA, SETTINGS)
    beams = Beams.from_scene(scene)
    time = torch.from_numpy(scene.time_s).double()  # type: ignore[arg-type]
    depth = (19.5 + 12.0 * time) / beams.directions[:, 0]
    at = depth[:, None] * beams.directions
    # The sides are visible too: only beams well within the front face are checked.
    front = (at[:, 1:].abs() < 1.4).all(-1)
    assert bool(rendering.hit_mask[front].all()) and int(front.sum()) > 100
    assert float((rendering.range_m - depth)[front].abs().max()) < 1e-8


def test_a_plate_that_drives_across_covers_other_beams_and_keeps_its_depth() -> None:
    scene = scene_of()
    rendering = chain_of(scene, 15.0, math.pi / 2).render(PLATE, THETA, SETTINGS)
    beams = Beams.from_scene(scene)
    depth = 19.5 / beams.directions[:, 0]
    y = depth * beams.directions[:, 1] - 15.0 * torch.from_numpy(scene.time_s).double()  # type: ignore[arg-type]
    front, clear = y.abs() < 1.5, y.abs() > 1.6
    assert bool(rendering.hit_mask[front].all()) and not bool(rendering.hit_mask[clear].any())
    assert float((rendering.range_m - depth)[front].abs().max()) < 1e-8
    placed = chain_of(scene, 0.0).render(PLATE, THETA, SETTINGS).hit_mask
    assert not torch.equal(placed, rendering.hit_mask)


def test_hits_lie_on_their_beams_and_the_other_rows_are_the_scenes_bit_for_bit() -> None:
    scene = scene_of()
    rendering = chain_of(scene, 15.0, 0.7).render(PLATE, THETA, SETTINGS)
    beams, hit = Beams.from_scene(scene), rendering.hit_mask
    exact = (beams.origins + rendering.range_m[:, None] * beams.directions)[hit]
    # To the precision of the dtype of the scene's points.
    assert float((rendering.points[hit].double() - exact).abs().max()) <= 21.0 * 2.0**-24
    assert torch.equal(rendering.points[~hit], torch.from_numpy(scene.points)[~hit])


@pytest.mark.parametrize("compensated", [True, False])
def test_the_sensors_own_motion_counts_where_points_do_not_contain_it(compensated: bool) -> None:
    conditions = Conditions(ego_velocity_m_s=(8.0, 1.0, 0.0), motion_compensated=compensated)
    scene = scene_of(conditions)
    context = EffectContext(scene, Beams.of_main_sensor(scene), FRAME, 1, 5.0, math.pi / 2)
    expected = (0.0, 5.0, 0.0) if compensated else (-8.0, 4.0, 0.0)
    assert relative_velocity(context) == pytest.approx(expected, abs=1e-12)
    shift = EFFECT.bind(context)(Cast(context.beams)).shift_m
    assert shift is not None and scene.time_s is not None
    assert shift.numpy() == pytest.approx(scene.time_s[:, None].astype(np.float64) * np.array(expected), abs=1e-12)


def test_object_and_sensor_at_the_same_speed_stand_still() -> None:
    scene = scene_of(Conditions(ego_velocity_m_s=(9.0, 0.0, 0.0), motion_compensated=False))
    cast = Cast(Beams.of_main_sensor(scene))
    assert EFFECT.bind(EffectContext(scene, cast.beams, FRAME, 1, 9.0, 0.0))(cast) is cast


def test_zero_speed_is_the_identity_bit_for_bit() -> None:
    scene = scene_of(Conditions(ego_velocity_m_s=(9.0, 0.0, 0.0)))
    cast = Cast(Beams.of_main_sensor(scene))
    assert EFFECT.bind(EffectContext(scene, cast.beams, FRAME, 1, 0.0, 1.0))(cast) is cast


def test_time_zero_is_not_displaced_and_displacement_grows_with_time() -> None:
    scene = scene_of()
    context = EffectContext(scene, Beams.of_main_sensor(scene), FRAME, 1, 20.0)
    shift = EFFECT.bind(context)(Cast(context.beams)).shift_m
    assert shift is not None and scene.time_s is not None
    assert bool((shift[scene.time_s == 0.0] == 0.0).all())
    assert float(shift[:, 0].max()) == pytest.approx(20.0 * SCAN_S, rel=1e-6)


def test_gradient_by_the_pose_is_that_of_finite_differences() -> None:
    scene, turned = scene_of(), THETA.clone()
    turned[3] = 0.3
    chain = chain_of(scene, 15.0, 0.3)
    pose = turned.clone().requires_grad_()
    rendering = chain.render(PLATE, pose, SETTINGS)
    # Beams that stay on the front face.
    at = rendering.points.detach().double() - turned[:3]
    row = int(torch.nonzero(rendering.hit_mask & (at[:, 1].abs() < 0.3)).squeeze(1)[0])
    beam = Beams.from_scene(scene).directions[row]
    (gradient,) = torch.autograd.grad((rendering.points[row].double() * beam).sum(), pose)
    for axis in range(6):
        step = torch.zeros(6, dtype=torch.float64)
        step[axis] = 1e-4
        ahead, back = (chain.render(PLATE, turned + s, SETTINGS).range_m[row] for s in (step, -step))
        assert float(gradient[axis]) == pytest.approx(float(ahead - back) / 2e-4, rel=1e-4, abs=1e-5)


def test_applies_where_the_displacement_exceeds_the_range_noise() -> None:
    scene = dataclasses.replace(scene_of(), sensor=SensorModel(range_noise_m=0.5))
    for speed, expected in ((4.9, False), (5.1, True), (-5.1, True)):
        facts = SceneFacts.of(scene, EffectSettings(object_speed_m_s=speed))
        assert (EFFECT.applicability(facts, DETECTOR) is not None) == expected
    unknown = ASSUMED_NOISE_M / SCAN_S
    for factor, expected in ((0.9, False), (1.1, True)):
        facts = SceneFacts.of(scene_of(), EffectSettings(object_speed_m_s=factor * unknown))
        assert (EFFECT.applicability(facts, DETECTOR) is not None) == expected


def test_applies_by_a_moving_sensor_only_where_points_do_not_contain_its_motion() -> None:
    for compensated in (True, False):
        conditions = Conditions(ego_velocity_m_s=(10.0, 0.0, 0.0), motion_compensated=compensated)
        reason = EFFECT.applicability(SceneFacts.of(scene_of(conditions)), DETECTOR)
        assert (reason is None) == compensated
        assert reason is None or ("10.0 m/s" in reason and "1.00 m" in reason)
