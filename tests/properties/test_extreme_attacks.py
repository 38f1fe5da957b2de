"""An attack ends with finite numbers for any weight and step length: lambda and alpha from 0 to 1e6."""

import math

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Frame, ground_scan, in_frame, soft_car
from hypothesis import given
from hypothesis import strategies as st
from property_worlds import few, random_object
from toy_detector import WaveDetector

from shift3d.attack.pose import PAPER_LIMITS, attack_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.shape import attack_shape
from shift3d.placement.constraints import Constraints
from shift3d.render import Beams, preset

FRAME = Frame((4.0, 1.8, 1.4), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
WEIGHTS = st.one_of(st.sampled_from([0.0, 1.0, 1e6]), st.floats(-6.0, 6.0).map(lambda e: 10.0**e))
STEPS = 4
SETTINGS = preset("standard").with_(dtype=torch.float64)


def near_scan() -> Beams:
    """Return the part of a scan that faces the object."""
    points, origin = ground_scan(rings=40, columns=400)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return Beams.from_arrays(points[np.abs(azimuth) < 0.4], origin)


THETA = torch.tensor([9.0, 0.5, -1.03, 0.4, 0.0, 0.0], dtype=torch.float64)
RULES = Constraints(overlap_m=10.0, contact_m=math.inf, min_object_points=0)
"""Constraints that any object meets, so that every step is kept."""
BEAMS = near_scan()
PROBLEMS = {
    "smooth shape": AttackProblem(
        BEAMS, -1.73, lambda code: in_frame(soft_car(code), FRAME), FRAME, WaveDetector(), THETA,
        torch.zeros(6, dtype=torch.float64), RULES, SETTINGS,
    ),
    "ReLU network": AttackProblem(
        BEAMS, -1.73, lambda code: random_object(3, code), FRAME, WaveDetector(), THETA,
        0.5 * torch.ones(4, dtype=torch.float64), RULES, SETTINGS,
    ),
}  # fmt: skip
EITHER = pytest.mark.parametrize("name", list(PROBLEMS))


def ended_well(result: AttackResult, problem: AttackProblem) -> None:
    assert torch.isfinite(result.latent_code).all() and torch.isfinite(result.theta).all()
    # Either every step was taken, or the last step left the finite numbers and the search reports it.
    assert (len(result.trace) == STEPS + 1) != (result.status == "diverged")
    # A loss is infinite only if the penalty itself overflows (it is of order alpha^2 lambda |gradient|^2).
    assert all(math.isfinite(record.adversarial_loss) for record in result.trace)
    assert all(record.unresolved_beams >= 0 and math.isfinite(record.max_residual_m) for record in result.trace)
    if result.best_step == 0:
        assert torch.equal(result.latent_code, problem.code0)
    else:
        assert result.best.valid and math.isfinite(result.best.loss)


@few(5)
@given(weight=WEIGHTS, alpha=WEIGHTS)
@EITHER
def test_the_shape_attack_ends(name: str, weight: float, alpha: float) -> None:
    problem = PROBLEMS[name]
    result = attack_shape(problem, weight, alpha, STEPS)
    ended_well(result, problem)
    if alpha == 0.0:
        # Nothing moves, so every record is that of the start. The first rendering is cold and may differ in a beam at
        # the silhouette; the others are warm and only come closer to the same roots.
        assert torch.equal(result.latent_code, problem.code0)
        cold, *warm = [record.adversarial_loss for record in result.trace]
        assert max(warm) - min(warm) <= 1e-5 * max(warm)
        assert cold == pytest.approx(warm[0], rel=0.01)


@few(5)
@given(alpha=WEIGHTS)
@EITHER
def test_the_pose_attack_ends_within_its_limits(name: str, alpha: float) -> None:
    problem = PROBLEMS[name]
    result = attack_pose(problem, alpha, STEPS)
    ended_well(result, problem)
    change = result.theta - problem.theta0
    # Projected to the limit, whose product with a unit vector is rounded three times.
    assert float(change[:2].norm()) <= PAPER_LIMITS.max_shift_m * (1 + 1e-15 * 9.0)
    assert float(change[4:].abs().max()) <= PAPER_LIMITS.max_tilt_rad * (1 + 1e-15)
    assert result.best_step > 0
    if alpha == 0.0:
        assert torch.equal(result.theta[[0, 1, 3, 4, 5]], problem.theta0[[0, 1, 3, 4, 5]])


def test_the_problems_are_seen() -> None:
    """The properties would be vacuous otherwise: both objects are rendered, and both have a gradient."""
    for problem in PROBLEMS.values():
        result = attack_shape(problem, 0.0, 0.01, 1)
        assert result.trace[0].check.object_points > 50
        assert result.trace[0].adversarial_loss != result.trace[1].adversarial_loss


def test_a_search_that_leaves_the_finite_numbers_says_so() -> None:
    problem = PROBLEMS["smooth shape"]
    result = attack_shape(problem, 1e6, 1e6, steps=40)
    assert result.status == "diverged" and len(result.trace) < 41
    assert torch.equal(result.latent_code, problem.code0)
