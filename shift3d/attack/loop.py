"""Algorithm 1: projected gradient descent with a full re-rendering a step, best valid step kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from shift3d.attack.objective import latent_distance
from shift3d.attack.problem import AttackProblem, Measurement, count_non_finite, measure
from shift3d.attack.records import AttackResult, StepRecord

Parameters = Callable[[Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class Search:
    """What distinguishes the shape attack from the pose attack.

    start: first value of the variable. parameters: variable -> (code, theta). penalty: variable -> scalar added
    to the loss. project: variable -> nearest variable that satisfies the hard constraints.
    """

    mode: Literal["shape", "pose"]
    start: Tensor
    parameters: Parameters
    penalty: Callable[[Tensor], Tensor]
    project: Callable[[Tensor], Tensor]


def descend(
    problem: AttackProblem,
    search: Search,
    steps: int,
    alpha: float,
    on_step: Callable[[StepRecord], None] | None = None,
) -> AttackResult:
    """Plain gradient descent: v <- Proj[v - alpha dL/dv], `steps` times.

    Of steps 1..steps the valid one with the lowest loss is kept; the start does not count unless none is
    valid, and is then returned as best_step 0.

    Source: SHIFT3D, Algorithm 1 (plain descent, 40 steps, alpha 0.01).
    """
    variable = search.start.detach().clone().requires_grad_()
    trace: list[StepRecord] = []
    best_step, best_loss, best = 0, float("inf"), search.parameters(search.start.detach())
    status, warm, follower = "no_valid_step", None, problem.follower()
    for step in range(steps + 1):
        code, theta = search.parameters(variable)
        measurement = measure(problem, code, theta, warm, follower=follower)
        warm = measurement.rendering.warm
        loss = measurement.adversarial + search.penalty(variable)
        gradient, milliseconds = _gradient(loss, variable) if step < steps else (None, 0.0)
        where = tuple(theta.detach().tolist()), latent_distance(code, problem.code0)
        record = _record(step, where, loss, gradient, measurement, milliseconds)
        trace.append(record)
        if on_step is not None:
            on_step(record)
        if step > 0 and record.valid and record.loss < best_loss:
            best_step, best_loss, best, status = step, record.loss, (code, theta), "ok"
        if gradient is None:
            break
        moved = search.project(variable.detach() - alpha * gradient)
        if not bool(torch.isfinite(moved).all()):
            status = "diverged"
            break
        variable = moved.requires_grad_()
    code, theta = (part.detach().clone() for part in best)
    return AttackResult(search.mode, code, theta, best_step, status, tuple(trace))


def _gradient(loss: Tensor, variable: Tensor) -> tuple[Tensor, float]:
    """dL/dv, zero where the loss does not depend on the variable (no hit, no overlapping proposal)."""
    start = time.perf_counter()
    if not loss.requires_grad:
        return torch.zeros_like(variable), 0.0
    (gradient,) = torch.autograd.grad(loss, variable, allow_unused=True)
    gradient = torch.zeros_like(variable) if gradient is None else gradient
    return gradient, 1e3 * (time.perf_counter() - start)


def _record(
    step: int,
    where: tuple[tuple[float, ...], float],
    loss: Tensor,
    gradient: Tensor | None,
    measured: Measurement,
    backward_ms: float,
) -> StepRecord:
    """where: the pose and the distance from the baseline's code."""
    rendering = measured.rendering
    return StepRecord(
        step=step,
        theta=where[0],
        latent_distance=where[1],
        loss=float(loss.detach()),
        adversarial_loss=float(measured.adversarial.detach()),
        proposal_score=measured.proposal_score,
        check=measured.check,
        unresolved_beams=rendering.unresolved_beams,
        max_residual_m=rendering.max_residual_m,
        evaluations=rendering.evaluations,
        grazing_gradient=None if gradient is None else rendering.grazing.gradient,
        least_slope=rendering.grazing.least_slope,
        non_finite=measured.non_finite + sum(count_non_finite(part) for part in (loss, gradient) if part is not None),
        milliseconds={**measured.milliseconds, "backward": backward_ms},
    )
