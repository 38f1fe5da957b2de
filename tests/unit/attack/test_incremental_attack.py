"""An attack with incremental inference takes the same path as one with full inference."""

import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, ground_scan, in_frame, soft_car
from random_networks import random_net
from torch import Tensor

from shift3d.attack import problem as problem_module
from shift3d.attack.pose import attack_pose
from shift3d.attack.problem import AttackProblem, measure
from shift3d.attack.records import AttackResult
from shift3d.attack.shape import attack_shape
from shift3d.detectors.incremental.inference import UncachedInference, incremental_inference
from shift3d.detectors.incremental.pillars import IncrementalPillars
from shift3d.detectors.incremental.tokens import IncrementalTokens
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.render import Beams, preset

FRAME = Frame((4.0, 1.8, 1.4), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
CODE = torch.zeros(6, dtype=torch.float64)
THETA = torch.tensor([9.5, 3.0, -1.03, 0.6, 0.0, 0.0], dtype=torch.float64)


def field_of(code: Tensor) -> Field:
    return in_frame(soft_car(code), FRAME)


@pytest.fixture(scope="module", params=["pointpillars", "sst"])
def problem(request: pytest.FixtureRequest) -> AttackProblem:
    beams = Beams.from_arrays(*ground_scan(rings=48, columns=720))
    detector = TrainedDetector(random_net(request.param), "float64")
    settings = preset("standard").with_(dtype=torch.float64)
    return AttackProblem(beams, -1.73, field_of, FRAME, detector, THETA, CODE, settings=settings)


def _attack(problem: AttackProblem, mode: str, alpha: float) -> AttackResult:
    if mode == "shape":
        return attack_shape(problem, 0.1, alpha=alpha, steps=4)
    return attack_pose(problem, alpha=alpha, steps=4)


@pytest.mark.parametrize(("mode", "alpha"), [("shape", 0.05), ("pose", 0.003)])
def test_following_changes_no_trajectory(
    problem: AttackProblem, mode: str, alpha: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert isinstance(problem.incremental_inference(), IncrementalPillars | IncrementalTokens)
    followed, again = _attack(problem, mode, alpha), _attack(problem, mode, alpha)
    monkeypatch.setattr(problem_module, incremental_inference.__name__, UncachedInference)
    plain = _attack(problem, mode, alpha)
    losses = [[record.loss for record in result.trace] for result in (followed, again, plain)]
    assert losses[0] == losses[1]
    assert max(losses[2]) - min(losses[2]) > 1e-4 * losses[2][0]  # the loss does change
    assert losses[0] == pytest.approx(losses[2], rel=1e-7)
    assert [record.proposal_score for record in followed.trace] == pytest.approx(
        [record.proposal_score for record in plain.trace], rel=1e-7
    )
    assert followed.best_step == plain.best_step
    assert torch.allclose(followed.latent_code, plain.latent_code, atol=1e-7, rtol=0)
    assert torch.allclose(followed.theta, plain.theta, atol=1e-7, rtol=0)


def test_a_pose_beyond_the_travel_is_measured_all_the_same(problem: AttackProblem) -> None:
    away = THETA + torch.tensor([9.0, -6.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    fork = problem.incremental_inference()
    for theta in (THETA, away, THETA):
        expected = measure(problem, CODE, theta)
        found = measure(problem, CODE, theta, incremental=fork)
        assert float(found.adversarial.detach()) == pytest.approx(float(expected.adversarial.detach()), rel=1e-9)
        assert torch.equal(found.proposals.anchor_index, expected.proposals.anchor_index)
