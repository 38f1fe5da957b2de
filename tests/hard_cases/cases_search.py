"""Hard cases of the search: NaN in steps, losses and gradients, and nothing to attack."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import torch
from analytic_fields import Field, Frame, ground_scan, in_frame, soft_car
from catalogue import hard_case
from torch import Tensor
from toy_detector import WaveDetector

from shift3d.attack.gradient_free import evolve
from shift3d.attack.joint import joint_search
from shift3d.attack.loop import descend
from shift3d.attack.pose import PAPER_LIMITS, PoseLimits, attack_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.shape import attack_shape, shape_search
from shift3d.attack.space import free_space
from shift3d.detectors.base import BevWindow, Proposals
from shift3d.placement.constraints import Constraints
from shift3d.render import Beams, preset

AREA = "constraints"
FRAME = Frame((4.0, 1.8, 1.4))
SETTINGS = preset("standard").with_(dtype=torch.float64, sdf_grid=False)
CODE = torch.zeros(6, dtype=torch.float64)
THETA = torch.tensor([10.0, 0.0, -1.04, 0.3, 0.0, 0.0], dtype=torch.float64)


@cache
def problem(min_object_points: int = 50) -> AttackProblem:
    """Return the attack on a small car on flat ground 10 m ahead, with the wave detector."""
    points, origin = ground_scan(rings=40, columns=480)
    beams = Beams.from_arrays(points[np.hypot(points[:, 0] - 10.0, points[:, 1]) < 5.0], origin)
    rules = Constraints(min_object_points=min_object_points)

    def field_of(code: Tensor) -> Field:
        return in_frame(soft_car(code), FRAME)

    return AttackProblem(beams, -1.73, field_of, FRAME, WaveDetector(), THETA, CODE, rules, SETTINGS)


@hard_case(
    area=AREA,
    why="an object that no beam reaches is missed by every detector: a blind spot that is none",
    must="it is never kept, however few points are required, as long as any are",
    guard="the share of the points that must remain is rounded up",
)
def an_object_wholly_occluded() -> None:
    side = np.linspace(-4.0, 4.0, 40)
    y, z = (axis.reshape(-1) for axis in np.meshgrid(side, side))
    wall = np.stack((np.full_like(y, 5.0), y, z), axis=1)
    under = np.array([[10.0, 0.0, -1.73], [10.2, 0.1, -1.73], [9.8, -0.1, -1.73]])  # for a sensor in the ground
    origins = np.concatenate((np.zeros_like(wall), under - np.array([0.0, 0.0, 1e-3])))
    beams = Beams.from_arrays(np.concatenate((wall, under)), origins)
    start = THETA + torch.tensor([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])  # 1 cm above these points
    hidden = replace(problem(1), beams=beams, theta0=start, _near=[])
    shape = attack_shape(hidden, 1.0, steps=2, snap_m=0.0)
    pose = attack_pose(hidden, steps=2, limits=PoseLimits(snap_m=0.0))
    for result in (shape, pose):
        assert (result.best_step, result.status) == (0, "no_valid_step")
        assert [record.check.object_points for record in result.trace] == [0, 0, 0]
        assert result.trace[2].check.contact_ok and result.trace[2].check.overlap_ok


class SquareRootDetector(WaveDetector):
    """Detector with the square root of a zero in its logits: they are finite, their gradient is not."""

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        found = super().proposals(points, window)
        return replace(found, logits=found.logits + torch.sqrt(0.0 * points[:, 0].sum()))


@hard_case(
    area=AREA,
    why="one NaN in the gradient spoils every number of the code or the pose, and every later step",
    must="the search ends there, says so, and returns the finite object that it had",
    guard="a step that leaves the finite numbers is not taken",
)
def a_gradient_that_is_no_number() -> None:
    broken = replace(problem(), detector=SquareRootDetector(), _near=[])
    for result in (attack_shape(broken, 1.0, steps=3), attack_pose(broken, steps=3)):
        assert result.status == "diverged" and len(result.trace) == 1 and result.best_step == 0
        assert torch.isfinite(result.latent_code).all() and torch.isfinite(result.theta).all()
        assert math.isfinite(result.trace[0].loss)


class ForgetfulDetector(WaveDetector):
    """Detector that returns NaN after its first answer."""

    def __init__(self) -> None:
        super().__init__()
        self.answers = 0

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        found = super().proposals(points, window)
        self.answers += 1
        return found if self.answers == 1 else replace(found, logits=found.logits * math.nan)


@hard_case(
    area=AREA,
    why="a NaN is not above the lowest loss so far, which is infinite before the first valid step",
    must="a step without a loss is never the best one",
    guard="a step is kept where its loss is lower, which a NaN is not",
)
def a_loss_that_is_no_number() -> None:
    for steps in (1, 3):
        forgetful = replace(problem(), detector=ForgetfulDetector(), _near=[])
        result = attack_shape(forgetful, 1.0, steps=steps)
        assert math.isnan(result.trace[1].loss) and result.trace[1].valid
        assert result.best_step == 0 and torch.equal(result.latent_code, CODE)


class StumblingDetector(WaveDetector):
    """Detector that adds a value to the logits of its fifth answer."""

    def __init__(self, added: float) -> None:
        super().__init__()
        self.added, self.answers = added, 0

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        found = super().proposals(points, window)
        self.answers += 1
        return replace(found, logits=found.logits + self.added) if self.answers == 5 else found


@hard_case(
    area=AREA,
    why="a NaN is neither less nor more than another loss: a generation sorted with one in it is in no order",
    must="an evolution goes on as if that candidate had the highest loss of all",
    guard="a loss that is no number ranks as infinite",
)
def one_loss_of_a_generation_that_is_no_number() -> None:
    visited = []
    for added in (math.nan, 1e3):
        stumbling = replace(problem(), detector=StumblingDetector(added), _near=[])
        result = evolve(stumbling, shape_search(stumbling, 0.0), 12, np.random.default_rng(0))
        assert math.isfinite(result.trace[4].loss) == math.isfinite(added)
        visited.append([record.latent_distance for record in result.trace])
    assert visited[0] == visited[1] and len(set(visited[0])) == 13


@hard_case(
    area=AREA,
    why="the pull of lambda throws the code to the other side, farther each time, until it overflows",
    must="the search ends in a few steps, with a finite code; with lambda 0 the same step size is no penalty at all",
    guard="a step that leaves the finite numbers is not taken",
)
def a_huge_lambda() -> None:
    for lambda_ in (1e100, 1e300):
        result = attack_shape(problem(), lambda_, alpha=1e6, steps=6)
        assert result.status == "diverged" and len(result.trace) < 5
        assert torch.isfinite(result.latent_code).all() and torch.isfinite(result.theta).all()


@hard_case(
    area=AREA,
    why="shape and pose together are searched in float64: of a finite step of 1e50 the float32 code is infinite",
    must="the search ends there, says so, and never asks for the field of such a code",
    guard="a step is also taken back where its code leaves the finite numbers",
)
def a_huge_lambda_on_shape_and_pose() -> None:
    def field_of(code: Tensor) -> Field:
        assert torch.isfinite(code).all(), "a decoder refuses such a code"
        return in_frame(soft_car(code), FRAME)

    single = replace(problem(), field_of=field_of, code0=CODE.float(), _near=[])
    for lambda_, alpha in ((1e9, 1e9), (1.0, 1e30)):
        search = joint_search(single, lambda_, free_space(single.code0), PAPER_LIMITS)
        result = descend(single, search, 8, alpha)
        assert result.status == "diverged" and len(result.trace) < 8
        assert torch.isfinite(result.latent_code).all() and torch.isfinite(result.theta).all()


@hard_case(
    area=AREA,
    why="the squared length of a code of 1e200 is infinite, and 0 times infinity is NaN",
    must="without lambda the loss is the detector's, finite at every step",
    guard="a lambda of 0 leaves the penalty out",
)
def no_lambda_and_a_huge_step() -> None:
    result = attack_shape(problem(), 0.0, alpha=1e200, steps=2)
    assert len(result.trace) == 3 and float(result.latent_code.abs().max()) < 1e300
    assert all(math.isfinite(record.loss) for record in result.trace)


class WatchingDetector(WaveDetector):
    """Detector that remembers the windows for which it was called."""

    def __init__(self) -> None:
        super().__init__()
        self.centres: list[tuple[float, float]] = []

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        self.centres.append(centre_xy)
        return super().window_for(centre_xy, radius_m)


@hard_case(
    area=AREA,
    why="a step of a million metres leads out of the scene and of the detector's range",
    must="the object stays within 4 m of its start at every step",
    guard="every step is projected onto the limits",
)
def a_step_of_a_million_metres() -> None:
    watching = WatchingDetector()
    result = attack_pose(replace(problem(), detector=watching, _near=[]), alpha=1e6, steps=2)
    assert len(watching.centres) == 4  # one of the window of incremental inference, one of every step
    assert max(math.dist(centre, THETA[:2].tolist()) for centre in watching.centres) <= 4.0 + 1e-9
    assert math.dist(watching.centres[-1], THETA[:2].tolist()) > 3.9
    assert all(math.isfinite(record.loss) for record in result.trace)


@hard_case(
    area=AREA,
    why="the square of a step of 1e200 m is infinite: divided by its length the step would be 0",
    must="the nearest pose in its direction, at the limit",
    guard="the length is taken without squares that overflow",
)
def a_step_whose_square_overflows() -> None:
    for alpha in (1e160, 1e300):
        result = attack_pose(problem(), alpha=alpha, steps=1)
        moved = (result.theta - THETA)[:2]
        assert result.trace[0].loss > 0 and abs(float(moved.norm()) - 4.0) < 1e-9


def nothing(x: Tensor) -> Tensor:
    """Return a field that is positive everywhere, like that of a code far off the prior."""
    return 3.0 + 0.1 * x.square().sum(-1).sqrt()


@hard_case(
    area=AREA,
    why="the field is positive everywhere: no beam is moved, and the loss does not depend on the pose",
    must="a gradient of 0 and no valid step, not an error of the backward pass",
    guard="the gradient of a loss without a graph is 0",
)
def a_pose_attack_on_a_code_that_draws_nothing() -> None:
    empty = replace(problem(), field_of=lambda code: nothing, _near=[])
    result = attack_pose(empty, steps=3)
    assert (result.status, result.best_step, len(result.trace)) == ("no_valid_step", 0, 4)
    assert all(math.isfinite(record.loss) and not record.check.points_ok for record in result.trace)
    assert torch.allclose(result.theta, THETA)


@hard_case(
    area=AREA,
    why="the shape under attack has left the ground, or vanished: there is no height at which it touches",
    must="it keeps the start's pose, is not valid, and the search goes on",
    guard="a shape that cannot be snapped to the ground is left where it is",
)
def a_shape_attack_from_a_code_that_draws_nothing() -> None:
    def field_of(code: Tensor) -> Field:
        return in_frame(lambda x: soft_car(code)(x) + code.square().sum(), FRAME)

    far = torch.full((6,), 5.0, dtype=torch.float64)
    result = attack_shape(replace(problem(), field_of=field_of, code0=far, _near=[]), 1.0, steps=2)
    assert (result.status, result.best_step, len(result.trace)) == ("no_valid_step", 0, 3)
    assert torch.equal(result.theta, THETA) and torch.equal(result.latent_code, far)
    assert not any(record.check.object_points for record in result.trace)
