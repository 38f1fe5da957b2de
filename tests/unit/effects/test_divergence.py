"""Cones at silhouettes against closed forms and against a plain reference that casts every sub-ray of every beam."""

import math

import numpy as np
import pytest
import torch
from analytic_fields import Field, Frame, box, in_frame, sphere
from torch import Tensor

from shift3d.effects.base import EffectContext, Insertion, Returns
from shift3d.effects.chain import SCENE_ALBEDO, EffectChain
from shift3d.effects.divergence import (
    EFFECT,
    LEAST_FOOTPRINT_M,
    PULSE_M,
    SUB_RAY_SHARE,
    strongest,
)
from shift3d.effects.physics.materials import albedo_of
from shift3d.effects.physics.power import OBJECT_FAR_M
from shift3d.effects.physics.silhouettes import sub_rays
from shift3d.geometry.se3 import scene_from_object
from shift3d.render import Beams, preset, render
from shift3d.render.rendering import Rendering
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Scene
from shift3d.scenes.sensor import NoReturnBeams, SensorModel

EXACT = preset("reference").with_(step_m=0.02)
CUBE = Frame(size_m=(2.0, 2.0, 2.0), scale_m=2.5)
BALL = in_frame(sphere(1.0), CUBE)
AHEAD = torch.tensor([20.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
ANGLE = 0.003
"""A beam's full angle; outer sub-rays are a third of it off the axis: 2 cm at 20 m."""


def scene_through(places: np.ndarray, behind: float = 2.0, reflectance: float | None = None) -> Scene:
    """Return beams from the origin through places (N, 3), with returns at `behind` times their range."""
    points = (behind * places).astype(np.float32)
    known = None if reflectance is None else np.full(len(points), reflectance, np.float32)
    origins = np.broadcast_to(np.zeros((1, 3), np.float32), points.shape)
    return Scene("silhouette", "made", points, origins, -1.7, reflectance=known)


def rendered(
    scene: Scene, field: Field, frame: Frame, theta: Tensor = AHEAD, angle: float | None = ANGLE
) -> tuple[Rendering, Rendering]:
    """Render with the effect, and without."""
    plain = render(Beams.of_main_sensor(scene), field, theta, frame, EXACT)
    if angle is None:
        return plain, plain
    chain = EffectChain.of(["divergence"], scene, frame, 1, EffectSettings(divergence_rad=angle))
    return chain.render(field, theta, EXACT), plain


def around_a_ball(count: int = 1500, behind: float = 2.0) -> Scene:
    """Return beams at a ball of 1 m, half of them within a few centimetres of its silhouette."""
    rng = np.random.default_rng(2)
    edge = 20.0 / math.sqrt(399.0)
    radius = np.concatenate((rng.uniform(0, 1.5, count // 2), edge + rng.uniform(-0.05, 0.05, count - count // 2)))
    turn = rng.uniform(0, 2 * math.pi, count)
    return scene_through(np.stack((np.full(count, 20.0), radius * np.cos(turn), radius * np.sin(turn)), 1), behind)


def ball_echoes(scene: Scene) -> tuple[Tensor, Tensor, Tensor]:
    """Return ranges, powers and ball mask (N, 7) of all sub-rays of all beams, by the closed form."""
    beams = Beams.of_main_sensor(scene)
    outer = sub_rays(beams.directions, SUB_RAY_SHARE * ANGLE / 2)
    directions = torch.cat((beams.directions[:, None], outer), 1)
    along = directions @ AHEAD[:3]
    discriminant = along**2 - 400.0 + 1.0
    hit = discriminant > 0
    depth = along - discriminant.clamp_min(0).sqrt()
    range_m = torch.where(hit, depth, beams.ranges_m[:, None])
    points = range_m[..., None] * directions
    cosine = -(directions * (points - AHEAD[:3])).sum(-1)
    albedo = albedo_of(points.reshape(-1, 3), AHEAD, CUBE).reshape(hit.shape)
    light = torch.where(hit, albedo * cosine, SCENE_ALBEDO)
    return range_m, light / range_m**2, hit


def ball_verdicts(scene: Scene) -> tuple[Tensor, Tensor, Tensor]:
    """Return (N,) per beam: if it returns from the ball, its range, and if the effect leaves it alone; plainly."""
    ranges, powers, hits = (part.tolist() for part in ball_echoes(scene))
    verdicts = []
    for range_m, power, hit in zip(ranges, powers, hits, strict=True):
        groups: list[list[int]] = []
        for echo in sorted(range(7), key=lambda i: range_m[i]):
            if groups and range_m[echo] - range_m[groups[-1][-1]] <= PULSE_M:
                groups[-1].append(echo)
            else:
                groups.append([echo])
        best = max(groups, key=lambda group: sum(power[i] for i in group))
        total = sum(power[i] for i in best)
        of_ball = sum(power[i] for i in best if hit[i]) >= 0.5 * total
        mean = sum(power[i] * range_m[i] for i in best) / total
        alone = (len(best) == 7 and all(hit)) or not any(hit)
        verdicts.append((of_ball, range_m[0] if alone else mean, alone))
    won, where, alone_ = zip(*verdicts, strict=True)
    return torch.tensor(won), torch.tensor(where, dtype=torch.float64), torch.tensor(alone_)


@pytest.mark.parametrize("behind", [2.0, 5.0])
def test_every_beam_about_a_ball_is_what_all_its_sub_rays_make_of_it(behind: float) -> None:
    scene = around_a_ball(behind=behind)
    rendering, plain = rendered(scene, BALL, CUBE)
    won, where, alone = ball_verdicts(scene)
    assert torch.equal(rendering.hit_mask, won)
    assert float((rendering.range_m - where)[won].abs().max()) < 1e-7
    gained, lost = won & ~plain.hit_mask, plain.hit_mask & ~won
    moved = plain.hit_mask & won & ~alone
    # A ball's edge reflects little: beams that it loses to a wall at 40 m, it wins from a wall at 100 m.
    assert int((lost if behind == 2.0 else gained).sum()) > 30 and int(moved.sum()) > 30
    assert 200 < int((~alone).sum()) < 400
    points = torch.from_numpy(scene.points)
    assert torch.equal(rendering.points[alone], plain.points[alone])
    assert torch.equal(rendering.points[~won], points[~won])


def test_points_on_the_object_lie_on_the_axis() -> None:
    scene = around_a_ball()
    rendering, _ = rendered(scene, BALL, CUBE)
    hit, beams = rendering.hit_mask, Beams.of_main_sensor(scene)
    exact = rendering.range_m[hit, None] * beams.directions[hit]
    assert float((rendering.points[hit].double() - exact).abs().max()) <= 21.0 * 2.0**-24


FRONT = 19.5
PLATE = Frame(size_m=(1.0, 3.0, 3.0), scale_m=2.5)
PLATE_FIELD = in_frame(box((0.5, 1.5, 1.5)), PLATE)
REACH = FRONT * math.tan(ANGLE / 3)


def past_the_edge(offsets: list[float]) -> np.ndarray:
    """Return places on the front face's plane, by their distance to the left of its left edge.

    Their sub-rays there are at REACH times 1, 1/2, -1/2, -1, -1/2, 1/2 to the left of the axis.
    """
    return np.array([[FRONT, 1.5 + offset, 0.0] for offset in offsets])


def test_a_known_share_of_the_cone_on_a_plate() -> None:
    # On the object: 7, 6, 4, 3, 1, 0 of 7. Paint at 19.5 m against three quarters of its albedo at 39 m.
    offsets = [factor * REACH for factor in (-1.3, -0.75, -0.25, 0.25, 0.75, 1.3)]
    rendering, plain = rendered(scene_through(past_the_edge(offsets)), PLATE_FIELD, PLATE)
    assert plain.hit_mask.tolist() == [True, True, True, False, False, False]
    one = 0.4 / FRONT**2 > 6 * SCENE_ALBEDO / (2 * FRONT) ** 2
    assert rendering.hit_mask.tolist() == [True, True, True, True, one, False]
    assert torch.equal(rendering.points[0], plain.points[0]) and torch.equal(rendering.points[5], plain.points[5])
    # Head on, sub-rays are longer only by 1 / cos of their angle.
    plane = FRONT / Beams.of_main_sensor(scene_through(past_the_edge(offsets))).directions[:, 0]
    assert float((rendering.range_m - plane)[:4].abs().max()) < 2.0 * ANGLE * 1.5


def test_a_bright_wall_outshines_the_edge_and_the_row_is_the_scenes_again() -> None:
    # 4 of 7 on paint of 0.4; 3 of 7 on albedo 1 at 20.5 m.
    scene = scene_through(past_the_edge([-0.25 * REACH]), behind=20.5 / FRONT, reflectance=1.0)
    rendering, plain = rendered(scene, PLATE_FIELD, PLATE)
    assert plain.hit_mask.tolist() == [True] and rendering.hit_mask.tolist() == [False]
    assert torch.equal(rendering.points, torch.from_numpy(scene.points))
    assert float(rendering.range_m[0]) == pytest.approx(float(plain_range(scene)), abs=1e-12)


def plain_range(scene: Scene) -> Tensor:
    return Beams.of_main_sensor(scene).ranges_m[0]


def test_echoes_within_a_pulse_merge_at_the_mean_by_power() -> None:
    scene = scene_through(past_the_edge([-0.25 * REACH]), behind=20.0 / FRONT, reflectance=0.4)
    rendering, plain = rendered(scene, PLATE_FIELD, PLATE)
    near, far = float(plain.range_m[0]), float(plain_range(scene))
    powers = 4 * 0.4 / near**2, 3 * 0.4 / far**2
    mean = (powers[0] * near + powers[1] * far) / sum(powers)
    assert float(rendering.range_m[0]) == pytest.approx(mean, abs=1e-3) and mean - near > 0.15


def test_a_no_return_beams_cone_needs_no_more_than_to_touch() -> None:
    scene = scene_through(past_the_edge([-1.3 * REACH]))
    aim = past_the_edge([0.75 * REACH, 1.3 * REACH])
    directions = (aim / np.linalg.norm(aim, axis=1, keepdims=True)).astype(np.float32)
    no_returns = NoReturnBeams(np.zeros((2, 3), np.float32), directions)
    scene = Scene("sky", "made", scene.points, scene.origins, -1.7, no_return=no_returns)
    chain = EffectChain.of(["no_return_beams", "divergence"], scene, PLATE, 1, EffectSettings(divergence_rad=ANGLE))
    rendering = chain.render(PLATE_FIELD, AHEAD, EXACT)
    assert rendering.hit_mask.tolist() == [True, True, False]
    assert rendering.returned is not None and rendering.returned.tolist() == [True, True, False]
    assert rendering.core is not None and rendering.core.hit_mask.tolist() == [True, False, False]


def stepped(scene: Scene, field: Field, frame: Frame, angle: float | None) -> tuple[Returns, Returns]:
    """Apply the step alone. Returns its input and its output."""
    sensor = None if angle is None else SensorModel(divergence_rad=angle)
    scene = Scene("step", "made", scene.points, scene.origins, -1.7, sensor=sensor)
    beams = Beams.of_main_sensor(scene)
    plain = render(beams, field, AHEAD, frame, EXACT)
    row = plain.hit_mask.nonzero().squeeze(1)
    yes, one = torch.ones(len(row), dtype=torch.bool), torch.ones(len(row), dtype=torch.float64)
    points = plain.range_m[row, None] * beams.directions[row]
    before = Returns(row, points, beams.origins[row], beams.directions[row], yes, yes, one, 0.4 * one)
    insertion = Insertion(beams, plain, field, AHEAD, frame, EXACT)
    return before, EFFECT.bind(EffectContext(scene, beams, frame, 1))(before, insertion)  # type: ignore[call-arg, arg-type, return-value]


def test_rows_handed_on_are_hits_and_gained_ones_ascending_and_their_light_is_the_cones() -> None:
    scene = around_a_ball()
    before, after = stepped(scene, BALL, CUBE, ANGLE)
    won, _, alone = ball_verdicts(scene)
    range_m, power, hit = ball_echoes(scene)
    assert bool((after.row.diff() > 0).all())
    assert torch.equal(after.row[after.on_object], won.nonzero().squeeze(1))
    assert set(before.row.tolist()) <= set(after.row.tolist())
    assert bool(after.returned.all())
    # Echoes of a ball's edge are within one pulse, so all of them count: their light is the object's.
    changed = after.on_object & ~alone[after.row]
    light = (torch.where(hit, power * range_m**2, 0.0).sum(1) / 7.0)[after.row]
    assert float((after.albedo * after.cosine - light)[changed].abs().max()) < 1e-6
    assert bool(((after.cosine >= 0) & (after.cosine <= 1) & (after.albedo >= 0) & (after.albedo <= 0.4)).all())
    same = alone[before.row]
    place = torch.searchsorted(after.row, before.row)
    for name in ("points", "cosine", "albedo"):
        assert torch.equal(getattr(after, name)[place][same], getattr(before, name)[same])


@pytest.mark.parametrize("angle", [None, 1e-9])
def test_no_divergence_is_the_identity_bit_for_bit(angle: float | None) -> None:
    before, after = stepped(around_a_ball(), BALL, CUBE, angle)
    for name, part in vars(before).items():
        assert part is None or torch.equal(getattr(after, name), part), name


def test_cones_all_on_one_face_leave_every_bit_as_it_was() -> None:
    rng = np.random.default_rng(1)
    scene = scene_through(np.stack((np.full(300, FRONT), *rng.uniform(-1.4, 1.4, (2, 300))), 1))
    before, after = stepped(scene, PLATE_FIELD, PLATE, ANGLE)
    assert len(before) == 300 and after is before


def test_twice_the_same_and_whatever_else_is_cast() -> None:
    scene = around_a_ball()
    first, _ = rendered(scene, BALL, CUBE)
    again, _ = rendered(scene, BALL, CUBE)
    assert torch.equal(first.points, again.points)
    half = Scene("half", "made", scene.points[::2], scene.origins[::2], -1.7)
    part, _ = rendered(half, BALL, CUBE)
    assert torch.equal(part.hit_mask, first.hit_mask[::2])
    assert torch.allclose(part.points, first.points[::2], rtol=0.0, atol=1e-5)


def test_gradient_of_the_range_is_that_of_finite_differences() -> None:
    turned = AHEAD.clone()
    turned[3:5] = torch.tensor([-0.25, 0.1])
    # The left edge of a turned plate's front, seen below the edge.
    edge = torch.tensor([[-0.5, 1.5, 0.1]], dtype=torch.float64)
    corner = scene_from_object(edge, turned)[0].numpy()
    places = np.array([[corner[0], corner[1] + k * REACH, corner[2]] for k in (-0.35, 0.35)])
    scene = scene_through(places)
    chain = EffectChain.of(["divergence"], scene, PLATE, 1, EffectSettings(divergence_rad=ANGLE))
    pose = turned.clone().requires_grad_()
    rendering = chain.render(PLATE_FIELD, pose, EXACT)
    assert rendering.core is not None
    assert rendering.hit_mask.tolist() == [True, True] and rendering.core.hit_mask.tolist() == [True, False]
    beams = Beams.of_main_sensor(scene)
    for row in (0, 1):
        along = (rendering.points[row].double() * beams.directions[row]).sum()
        (gradient,) = torch.autograd.grad(along, pose, retain_graph=True)
        for axis in range(6):
            step = torch.zeros(6, dtype=torch.float64)
            step[axis] = 1e-5
            ahead, back = (chain.render(PLATE_FIELD, turned + s, EXACT).range_m[row] for s in (step, -step))
            # A translation keeps the ratios of powers; a turn changes them, which the gradient leaves out.
            close = {"rel": 1e-4, "abs": 1e-5} if axis < 3 else {"rel": 1e-2, "abs": 1e-2}
            assert float(gradient[axis]) == pytest.approx(float(ahead - back) / 2e-5, **close), (row, axis)


def test_the_strongest_group_of_echoes() -> None:
    gap, link = 1.01 * PULSE_M, 0.99 * PULSE_M
    range_m = torch.tensor(
        [[10.0, 10.0 + gap, 10.0 + gap + link], [10.0 + link, 10.0, 10.0 + 2 * link], [30.0, 20.0, 10.0]],
        dtype=torch.float64,
    )
    power = torch.tensor([[2.0, 1.1, 1.0], [1.0, 1.0, 1.0], [1.0, 2.0, 2.0]], dtype=torch.float64)
    assert strongest(range_m, power).tolist() == [[False, True, True], [True, True, True], [False, False, True]]


def test_applies_by_the_width_of_the_cone_at_the_farthest_place() -> None:
    detector = DetectorFacts("any")
    widest = LEAST_FOOTPRINT_M / OBJECT_FAR_M
    for factor, expected in ((0.99, False), (1.01, True)):
        facts = SceneFacts.of(around_a_ball(4), EffectSettings(divergence_rad=factor * widest))
        assert (EFFECT.applicability(facts, detector) is not None) == expected
    reason = EFFECT.applicability(SceneFacts.of(around_a_ball(4), EffectSettings(divergence_rad=0.003)), detector)
    assert reason is not None and "15 cm" in reason and "50 m" in reason
