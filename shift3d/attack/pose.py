"""Adversarial pose: descent on the six numbers of theta, projected to the ball around the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.loop import descend
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.attack.trials import Search
from shift3d.placement.constraints import snap_to_ground
from shift3d.render.field.object_field import ObjectField


@dataclass(frozen=True)
class PoseLimits:
    """The set B(theta0) of allowed poses.

    max_shift_m: largest Euclidean |dxy|. max_tilt_rad: largest |change| of pitch and of roll from theta0's, which are
    those of the ground at the object's placement. Yaw is free.
    snap_m: largest vertical distance of the object from the ground plane at its new position; 0: the gradient moves z.
    Source: SHIFT3D, Adversarial Pose Generation Results: displacement under 4 m on the xy-plane, pitch and roll under
    0.1 rad, yaw free. z is our choice, the paper is silent: the object has to touch the ground within 2 cm, and no
    gradient of the detector enforces that, so z follows the ground (see `constraints.snap_to_ground`).
    """

    max_shift_m: float = 4.0
    max_tilt_rad: float = 0.1
    snap_m: float = 0.3


PAPER_LIMITS = PoseLimits()
"""The paper's values."""


def pose_search(problem: AttackProblem, limits: PoseLimits = PAPER_LIMITS) -> Search:
    """Define min_theta L_adv(theta) over B(theta0) at a fixed shape. The ground-truth box moves with the pose.

    Source: SHIFT3D eq. loss_theta.
    """
    metric = problem.metric(problem.code0.detach())
    return Search(
        start=problem.theta0.double(),
        parameters=lambda theta: (problem.code0.detach(), theta),
        penalty=lambda theta: theta.new_zeros(()),
        project=lambda theta: snap_pose(project(theta, problem.theta0, limits), problem, metric, limits),
        draw=lambda rng, distance: snap_pose(draw_pose(problem.theta0, rng, limits), problem, metric, limits),
    )


def attack_pose(
    problem: AttackProblem,
    alpha: float = 0.01,
    steps: int = 40,
    limits: PoseLimits = PAPER_LIMITS,
    on_step: Callable[[StepRecord], None] | None = None,
    selection_window: int = 0,
) -> AttackResult:
    """Run the paper's adversarial pose attack: plain descent on `pose_search`.

    selection_window: rule for the kept step, see `shift3d.attack.loop.best_step`.
    Source: SHIFT3D eq. loss_theta and Algorithm 1.
    """
    return descend(problem, pose_search(problem, limits), steps, alpha, on_step, selection_window)


def draw_pose(theta0: Tensor, rng: np.random.Generator, limits: PoseLimits) -> Tensor:
    """Draw a random pose (6,) in B(theta0): shift uniform in the disc, yaw uniform, pitch and roll in the limits.

    Source: SHIFT3D, Adversarial Pose Generation Results ("random pose perturbations with the same constraints").
    """
    shift = limits.max_shift_m * np.sqrt(rng.random())
    direction, yaw = 2.0 * np.pi * rng.random(2)
    pitch, roll = limits.max_tilt_rad * (2.0 * rng.random(2) - 1.0)
    theta = theta0.detach().double().clone()
    change = [shift * np.cos(direction), shift * np.sin(direction), 0.0, yaw, pitch, roll]
    return theta + torch.tensor(change, dtype=torch.float64)


def project(theta: Tensor, theta0: Tensor, limits: PoseLimits) -> Tensor:
    """Return the nearest pose (6,) within the shift and tilt limits; z and yaw do not change.

    Source: SHIFT3D, Proj_B in Algorithm 1.
    """
    start = theta0.detach().to(theta.dtype)
    change = theta.detach() - start
    # hypot does not overflow: a step of 1e200 m has a finite length and keeps its direction.
    shift = torch.hypot(change[0], change[1])
    if float(shift) > limits.max_shift_m:
        change[:2] *= limits.max_shift_m / shift
    change[4:] = change[4:].clamp(-limits.max_tilt_rad, limits.max_tilt_rad)
    return start + change


def snap_pose(theta: Tensor, problem: AttackProblem, metric: ObjectField, limits: PoseLimits) -> Tensor:
    """Return the pose with its height set to the ground at its position.

    The height starts at that of the ground plane (if no ground is visible, at theta0's). The object then moves up or
    down until it touches a return, or the ground between returns (`AttackProblem.below_ground_m`). If nothing in reach
    carries it, for example on top of a wall, it stays at the first height, and the step breaks a constraint.
    """
    if limits.snap_m == 0 or not bool(torch.isfinite(theta).all()):
        return theta
    size = problem.size_m
    on_ground = theta.detach().clone()
    plane = problem.ground_at(theta)
    on_ground[2] = problem.theta0[2] if plane is None else plane.height_m + size[2] / 2
    found = snap_to_ground(metric, problem.obstacles_at(theta), on_ground, size, limits.snap_m)
    return on_ground if found is None else found
