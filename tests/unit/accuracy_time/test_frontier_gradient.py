"""The timed attack step takes the loss's own gradient; gradients are compared as vectors."""

from __future__ import annotations

import math

import pytest
import torch
from attack_by_hand import CODE, THETA, small_problem

from shift3d.accuracy_time.gradient import attack_step, cosine, norm_ratio
from shift3d.accuracy_time.truth import attacked_code
from shift3d.attack.problem import measure


@pytest.mark.parametrize("radius_m", [8.0, None])
def test_the_way_back_in_two_parts_gives_the_gradient_of_one(radius_m: float | None) -> None:
    problem = small_problem()
    step = attack_step(problem, CODE, THETA, radius_m)
    code, theta = CODE.clone().requires_grad_(), THETA.clone().requires_grad_()
    measured = measure(problem, code, theta, radius_m=radius_m)
    dz, dtheta = torch.autograd.grad(measured.adversarial, (code, theta))
    assert float(dz.norm()) > 0 and float(dtheta.norm()) > 0
    assert torch.allclose(step.dz, dz, rtol=1e-12) and torch.allclose(step.dtheta, dtheta, rtol=1e-12)
    assert step.loss == float(measured.adversarial.detach())
    assert 0 < step.render_ms < step.total_ms and 0 < step.detector_ms < step.total_ms


def test_a_gradient_at_the_points_is_walked_back_in_place_of_the_detectors() -> None:
    step = attack_step(small_problem(), CODE, THETA, 8.0)
    assert step.at_points is not None
    other = step.at_points.flip(1)
    walked = attack_step(small_problem(), CODE, THETA, 8.0, at_points=other)
    code, theta = CODE.clone().requires_grad_(), THETA.clone().requires_grad_()
    points = small_problem().insert(code, theta).points
    dz, dtheta = torch.autograd.grad(points, (code, theta), other)
    assert torch.allclose(walked.dz, dz) and torch.allclose(walked.dtheta, dtheta)
    assert cosine(walked.dz, step.dz) < 0.99


def test_what_is_not_asked_for_has_no_gradient() -> None:
    problem = small_problem()
    shape, pose = (attack_step(problem, CODE, THETA, 8.0, of_code=code, of_pose=not code) for code in (True, False))
    both = attack_step(problem, CODE, THETA, 8.0)
    assert not shape.dtheta.any() and not pose.dz.any()
    assert torch.allclose(shape.dz, both.dz) and torch.allclose(pose.dtheta, both.dtheta)


def test_a_vehicle_that_no_beam_meets_has_the_gradient_zero() -> None:
    above = THETA + torch.tensor([0.0, 0.0, 30.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    step = attack_step(small_problem(), CODE, above, 8.0)
    assert not step.dz.any() and not step.dtheta.any() and step.rendering.object_points == 0


def test_the_displaced_shape_has_a_lower_loss() -> None:
    problem = small_problem()
    moved = attacked_code(problem, lambda_=0.0, alpha=0.02, steps=5)
    before, after = (attack_step(problem, code, THETA, 8.0).loss for code in (CODE, moved))
    assert after < before and moved.dtype == torch.float64
    assert torch.equal(attacked_code(problem, 1.0, 0.02, 0), CODE)


def test_a_heavy_penalty_keeps_the_displaced_shape_near() -> None:
    problem = small_problem()
    far, near = (attacked_code(problem, weight, 0.02, 5) for weight in (0.0, 20.0))
    assert float((near - CODE).norm()) < float((far - CODE).norm())


def test_cosine_and_ratio_of_gradients() -> None:
    a, b = torch.tensor([3.0, 4.0]), torch.tensor([6.0, 8.0])
    assert cosine(a, b) == pytest.approx(1.0) and norm_ratio(b, a) == pytest.approx(2.0)
    assert cosine(a, torch.tensor([-4.0, 3.0])) == pytest.approx(0.0)
    assert cosine(a, torch.tensor([4.0, 3.0])) == pytest.approx(24 / 25)
    zero = torch.zeros(2)
    assert (cosine(zero, zero), norm_ratio(zero, zero)) == (1.0, 1.0)
    assert cosine(a, zero) == 0.0 and math.isfinite(norm_ratio(a, zero)) and norm_ratio(zero, a) == 0.0
    for broken in (torch.tensor([math.nan, 1.0]), torch.tensor([math.inf, 1.0])):
        assert cosine(broken, a) == cosine(broken, zero) == 0.0 and norm_ratio(broken, a) == 1e9
