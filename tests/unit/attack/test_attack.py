"""Placement, both attacks and their baselines, against a small real detector."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, ground_scan, in_frame, soft_car
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack import baselines
from shift3d.attack.baselines import noise_codes, random_code, random_pose
from shift3d.attack.expectation import descend_expectation
from shift3d.attack.loop import descend
from shift3d.attack.pose import PoseLimits, attack_pose, pose_search, project
from shift3d.attack.problem import AttackProblem, measure
from shift3d.attack.shape import attack_shape, on_ground, shape_search
from shift3d.detectors.base import BevWindow, Proposals
from shift3d.placement.constraints import Constraints
from shift3d.placement.sampling import NoPlacement, Placement, PlacementContext, PlacementLimits, format_refusals, place
from shift3d.render import Beams, SdfGrid, preset

FRAME = Frame((4.0, 1.8, 1.4), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
CODE = torch.zeros(6, dtype=torch.float64)
LIMITS = PlacementLimits(8.0, 12.0, attempts=80)
SETTINGS = preset("standard").with_(dtype=torch.float64)
RULES = Constraints(min_object_points=150)


def field_of(code: Tensor) -> Field:
    return in_frame(soft_car(code), FRAME)


@pytest.fixture(scope="module")
def beams() -> Beams:
    return Beams.from_arrays(*ground_scan(rings=64, columns=900))


@pytest.fixture(scope="module")
def placement(beams: Beams) -> Placement:
    found = place(
        PlacementContext(beams, -1.73), field_of(CODE), FRAME, np.random.default_rng(3), LIMITS, RULES, SETTINGS
    )
    assert isinstance(found, Placement)
    return found


@pytest.fixture(scope="module")
def problem(beams: Beams, placement: Placement) -> AttackProblem:
    return AttackProblem(beams, -1.73, field_of, FRAME, WaveDetector(), placement.theta, CODE, RULES, SETTINGS)


def test_a_placement_satisfies_everything(placement: Placement) -> None:
    assert placement.check.valid and placement.check.object_points >= 150
    assert 8.0 <= float(placement.theta[:2].norm()) <= 12.0
    assert float(placement.theta[2]) == pytest.approx(-1.73 + 0.7, abs=0.07)
    assert placement.theta[4:].abs().max() < 0.01
    assert placement.rendering.object_points == placement.check.object_points


def test_placement_is_decided_by_the_seed(beams: Beams, placement: Placement) -> None:
    def again(seed: int) -> Tensor:
        found = place(
            PlacementContext(beams, -1.73), field_of(CODE), FRAME, np.random.default_rng(seed), LIMITS, RULES, SETTINGS
        )
        assert isinstance(found, Placement)
        return found.theta

    assert torch.equal(again(3), placement.theta)
    assert not torch.equal(again(4), placement.theta)


def test_the_sector_is_respected(beams: Beams) -> None:
    limits = PlacementLimits(8.0, 12.0, sector=(math.pi / 2, 0.3), attempts=80)
    found = place(
        PlacementContext(beams, -1.73), field_of(CODE), FRAME, np.random.default_rng(0), limits, RULES, SETTINGS
    )
    assert isinstance(found, Placement)
    assert abs(math.atan2(float(found.theta[1]), float(found.theta[0])) - math.pi / 2) <= 0.3


def test_a_scene_without_room_says_why(beams: Beams) -> None:
    limits = PlacementLimits(40.0, 50.0, attempts=6)
    found = place(
        PlacementContext(beams, -1.73), field_of(CODE), FRAME, np.random.default_rng(0), limits, RULES, SETTINGS
    )
    assert isinstance(found, NoPlacement)
    assert sum(found.rejected.values()) == 6 and found.attempts == 6 and format_refusals(found.rejected)


def test_zero_steps_change_nothing(problem: AttackProblem) -> None:
    for result in (attack_shape(problem, 1.0, steps=0), attack_pose(problem, steps=0)):
        assert torch.equal(result.latent_code, CODE) and torch.equal(result.theta, problem.theta0)
        assert (result.best_step, result.status, len(result.trace)) == (0, "no_valid_step", 1)


def test_a_step_of_length_zero_changes_nothing(problem: AttackProblem) -> None:
    result = attack_shape(problem, 1.0, alpha=0.0, steps=2)
    assert torch.equal(result.latent_code, CODE)
    losses = [record.loss for record in result.trace]
    # A warm hit and a cold hit are both accurate to 3 micrometres, so their last digits differ.
    assert losses[0] == pytest.approx(losses[2], rel=1e-5)


def test_the_shape_attack_lowers_the_loss(problem: AttackProblem) -> None:
    result = attack_shape(problem, 0.01, alpha=0.05, steps=10)
    assert result.status == "ok" and result.best_step > 0
    assert result.best.loss < 0.97 * result.trace[0].loss
    assert result.best.valid
    assert result.best.loss == min(r.loss for r in result.trace[1:] if r.valid)
    # The record is the loss of the returned object.
    again = measure(problem, result.latent_code, result.theta)
    assert float(again.adversarial) == pytest.approx(result.best.adversarial_loss, rel=1e-3)
    assert set(result.milliseconds()) == {"placement", "render", "detector", "constraints", "backward"}


def test_lambda_holds_the_shape_back(problem: AttackProblem) -> None:
    free = attack_shape(problem, 0.0, alpha=0.02, steps=5)
    held = attack_shape(problem, 20.0, alpha=0.02, steps=5)
    assert 0 < float(held.latent_code.norm()) < float(free.latent_code.norm())


class BlindDetector(WaveDetector):
    """Detector without proposals, like a user's that drops low scores: the loss is 0 and has no gradient."""

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        found = super().proposals(points, window)
        return Proposals(found.boxes[:0], found.logits[:0], found.anchor_index[:0])


@pytest.mark.parametrize("search", ["descent", "expectation"])
def test_a_search_that_never_leaves_the_unchanged_vehicle_has_no_solution(problem: AttackProblem, search: str) -> None:
    blind, rng = replace(problem, detector=BlindDetector()), np.random.default_rng(0)
    shape = shape_search(blind, 1.0)
    mean = search == "expectation"
    found = descend_expectation(blind, shape, 2, 0.1, rng, 1) if mean else descend(blind, shape, 2, 0.01)
    assert [step.loss for step in found.trace] == [0.0] * 3 and found.best.valid
    assert (found.best_step, found.status) == (0, "no_valid_step") and torch.equal(found.latent_code, CODE)


def test_ascending_would_raise_the_loss(problem: AttackProblem) -> None:
    # The same loop with the opposite sign: if the gradient's sign were wrong, this loop would win.
    down = attack_shape(problem, 0.0, alpha=0.02, steps=3)
    up = attack_shape(problem, 0.0, alpha=-0.02, steps=3)
    assert down.trace[3].loss < down.trace[0].loss < up.trace[3].loss


def test_the_pose_attack_lowers_the_loss_within_its_limits(problem: AttackProblem) -> None:
    limits = PoseLimits(max_shift_m=0.5, max_tilt_rad=0.02)
    result = attack_pose(problem, alpha=0.01, steps=10, limits=limits)
    assert result.status == "ok" and result.best.loss < result.trace[0].loss
    change = result.theta - problem.theta0
    assert float(change[:2].norm()) <= 0.5 + 1e-9 and float(change[4:].abs().max()) <= 0.02 + 1e-12
    assert result.best.check.contact_ok and result.best.check.overlap_ok
    assert torch.equal(result.latent_code, CODE)


def test_a_step_that_no_beam_meets_is_followed_by_one_half_way_back(problem: AttackProblem) -> None:
    buried = problem.theta0 - torch.tensor([0.0, 0.0, 5.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    first = iter([buried])
    search = replace(pose_search(problem), project=lambda theta: next(first, theta))
    trace = descend(problem, search, steps=2, alpha=0.01).trace
    assert trace[1].theta == tuple(buried.tolist()) and trace[1].check.object_points == 0
    assert trace[2].theta == pytest.approx(((problem.theta0 + buried) / 2).tolist())


def test_attacks_repeat_to_the_bit(problem: AttackProblem) -> None:
    first, second = (attack_shape(problem, 0.1, alpha=0.05, steps=3) for _ in range(2))
    assert torch.equal(first.latent_code, second.latent_code)
    assert [r.loss for r in first.trace] == [r.loss for r in second.trace]


def test_no_valid_step_keeps_the_baseline(problem: AttackProblem) -> None:
    strict = replace(problem, constraints=Constraints(min_object_points=10**6))
    result = attack_shape(strict, 0.1, alpha=0.05, steps=2)
    assert (result.best_step, result.status) == (0, "no_valid_step")
    assert torch.equal(result.latent_code, CODE)


def test_a_huge_step_ends_without_nan(problem: AttackProblem) -> None:
    result = attack_shape(problem, 1e4, alpha=1e4, steps=4)
    assert result.status in ("diverged", "no_valid_step", "ok")
    assert torch.isfinite(result.latent_code).all()
    pose = attack_pose(problem, alpha=1e6, steps=3)
    assert float((pose.theta - problem.theta0)[:2].norm()) <= 4.0 + 1e-9


def test_projection() -> None:
    start = torch.tensor([10.0, 5.0, -1.0, 1.0, 0.02, 0.0], dtype=torch.float64)
    away = start + torch.tensor([6.0, 8.0, 0.5, 3.0, 0.5, -0.05], dtype=torch.float64)
    moved = project(away, start, PoseLimits()) - start
    assert moved.tolist() == pytest.approx([2.4, 3.2, 0.5, 3.0, 0.1, -0.05])
    inside = start + 0.01
    assert torch.allclose(project(inside, start, PoseLimits()), inside)


def test_random_code_lies_on_the_sphere() -> None:
    rng = np.random.default_rng(0)
    start = torch.randn(256, dtype=torch.float32)
    codes = torch.stack([random_code(start, 0.7, rng) for _ in range(20)])
    assert torch.allclose((codes - start).norm(dim=1), torch.tensor(0.7), atol=1e-5)
    assert float((codes - start).mean(0).norm()) < 0.7 / 2
    assert torch.equal(random_code(start, 0.0, rng), start)


def test_noise_has_its_sigma() -> None:
    noisy = noise_codes(torch.zeros(256), 0.01, 10, np.random.default_rng(0))
    assert noisy.shape == (10, 256)
    assert float(noisy.std()) == pytest.approx(0.01, rel=0.1)


def test_random_pose_is_feasible(problem: AttackProblem) -> None:
    limits = PoseLimits(max_shift_m=1.0, max_tilt_rad=0.02)
    theta = random_pose(problem, np.random.default_rng(0), limits)
    assert theta is not None
    held = measure(problem, problem.code0, theta).check
    assert held.valid and held.object_points >= 150
    assert float((theta - problem.theta0)[:2].norm()) <= 1.0
    assert float((theta - problem.theta0)[4:].abs().max()) <= 0.02


def test_no_random_pose_is_a_result_not_an_error(problem: AttackProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(baselines, "_ATTEMPTS", 20)
    strict = replace(problem, constraints=Constraints(min_object_points=10**6))
    assert random_pose(strict, np.random.default_rng(0)) is None


def test_a_changed_shape_keeps_standing_on_the_ground(problem: AttackProblem) -> None:
    # The third number scales the height: without snapping to the ground this shape would float or sink.
    code = torch.tensor([0.0, 0.0, -0.4, 0.0, 0.0, 0.0], dtype=torch.float64)
    theta = on_ground(code, problem, 0.15)
    assert float(theta[2]) < float(problem.theta0[2]) - 0.02
    assert torch.equal(theta[[0, 1, 3, 4, 5]], problem.theta0[[0, 1, 3, 4, 5]])
    assert measure(problem, code, theta).check.contact_ok
    assert not measure(problem, code, problem.theta0).check.contact_ok
    assert torch.equal(on_ground(code, problem, 0.0), problem.theta0)


def test_placement_stays_clear_of_the_scenes_vehicles(beams: Beams, placement: Placement) -> None:
    others = placement.theta[None, :2].clone()
    found = place(
        PlacementContext(beams, -1.73, others), field_of(CODE), FRAME, np.random.default_rng(3), LIMITS, RULES, SETTINGS
    )
    assert isinstance(found, Placement)
    assert float((found.theta[:2] - others[0]).norm()) > RULES.clear_m
    assert found.rejected["neighbour"] >= 1


def test_an_sdf_grid_changes_no_result(problem: AttackProblem) -> None:
    mapped = replace(problem, space=SdfGrid.of(field_of(CODE), FRAME, SETTINGS))
    plain = measure(problem, CODE, problem.theta0)
    assert float(measure(mapped, CODE, problem.theta0).adversarial) == pytest.approx(float(plain.adversarial), rel=1e-4)
    assert mapped.sdf_grid_for(CODE + 0.1) is None
