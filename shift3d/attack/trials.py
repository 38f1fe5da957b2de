"""Evaluation loop of every search: variable -> object -> rendering -> detector -> step record."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.attack.objective import latent_distance
from shift3d.attack.problem import AttackProblem, Measurement, count_non_finite, measure
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.render.field.object_field import VehicleFrame
from shift3d.render.solvers.search import WarmStart

FREE_DISTANCE = 0.2
"""Latent distance of draws in the free space; about the distance of the paper's solutions from their baselines."""
Parameters = Callable[[Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class OtherPlace:
    """Another place for the same shape, with equal weight in the loss. stands: code (d,) -> its pose (6,) there."""

    problem: AttackProblem
    stands: Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Search:
    """The optimization problem of a search, independent of the search algorithm.

    start: first value of the variable. parameters: variable -> (code, theta). penalty: variable -> scalar added to the
    loss. project: variable -> nearest variable that satisfies the hard constraints. draw: (generator, latent distance)
    -> random variable within the allowed set; if the set has no bound, as in the free space of codes, one at that
    distance from the start. elsewhere: other places in the loss of a universal shape. natural: code (d,) -> True if the
    code is within the budget of naturalness; None: no budget. The check is slow and runs only for candidates for the
    kept step: a valid step with a loss below all others.
    """

    start: Tensor
    parameters: Parameters
    penalty: Callable[[Tensor], Tensor]
    project: Callable[[Tensor], Tensor]
    draw: Callable[[np.random.Generator, float], Tensor]
    elsewhere: tuple[OtherPlace, ...] = ()
    natural: Callable[[Tensor], bool] | None = None


@dataclass(frozen=True)
class Family:
    """The kinds of vehicle that a search may switch to, at one place before one detector.

    order: numbers of the kinds, in the order in which starts use them. of: number -> problem and search of the kind;
    each kind has coordinates of its own.
    """

    order: tuple[int, ...]
    of: Callable[[int], tuple[AttackProblem, Search]]


def order_by_rarity(codes: NDArray[np.float32], known: NDArray[np.float32]) -> tuple[int, ...]:
    """Return the numbers of codes (N, d), farthest from the mean of the known codes (M, d) first.

    A detector has learned least about rare shapes. Source: our choice.
    """
    away = np.linalg.norm(codes.astype(np.float64) - known.mean(axis=0, dtype=np.float64), axis=1)
    return tuple(np.argsort(-away, kind="stable").tolist())


class SearchEvaluator:
    """The evaluations of one search, in their order.

    Each rendering starts from the last one's hits, and the detector computes only what a move has changed. held:
    variable to which an unsuccessful step goes back: the best so far, or the search's start. differentiable: False for
    searches that never use a gradient; then no graph is kept. every_step: check the naturalness of every valid step,
    for a search that may keep another step than the lowest.
    """

    def __init__(
        self,
        problem: AttackProblem,
        search: Search,
        on_step: Callable[[StepRecord], None] | None = None,
        differentiable: bool = True,
        every_step: bool = False,
    ) -> None:
        self.trace: list[StepRecord] = []
        self.variables: list[Tensor] = []
        self._on_step, self._differentiable, self._every_step = on_step, differentiable, every_step
        self._lowest = math.inf  # lowest loss of a valid step after the start
        self._code0 = problem.code0
        self._tried: list[tuple[VehicleFrame, Tensor, Tensor]] = []
        self.switch_kind(problem, search)
        self._incremental = [place.problem.incremental_inference() for place in self._places]

    def switch_kind(self, problem: AttackProblem, search: Search) -> None:
        """Switch to a vehicle of another kind with the same detector and places."""
        self._problem, self._search, self.held = problem, search, search.start.detach()
        # The search's own place, then the others.
        self._places = [OtherPlace(problem, lambda code: problem.theta0), *search.elsewhere]
        self._warm: list[WarmStart | None] = [None] * len(self._places)

    def evaluate(self, variable: Tensor, with_gradient: bool, shifts: Sequence[Tensor] = ()) -> Tensor | None:
        """Evaluate a variable and record it as the next step; returns the gradient of the loss, None if not requested.

        shifts: changes of the pose, (6,) each; loss and gradient are the mean over the pose, its shifts, and the
        search's other places. The validity of the step is that of the unshifted pose, which is measured first. The
        first object, evaluated again, is no solution. A loss that does not depend on the variable (no hit, no
        overlapping proposal) has the gradient 0.
        """
        variable = variable.detach().clone().requires_grad_(self._differentiable)
        start = time.perf_counter()
        code, theta = self._search.parameters(variable)
        spent: dict[str, float] = defaultdict(float, placement=1e3 * (time.perf_counter() - start))
        penalty = self._search.penalty(variable)
        poses = [(0, theta), *((0, theta + shift) for shift in shifts)]
        poses += [(index, place.stands(code)) for index, place in enumerate(self._places) if index]
        losses: list[Tensor] = []
        gradient, first = None, None
        for number, (index, pose) in enumerate(poses):
            problem = self._places[index].problem
            measured = measure(problem, code, pose, self._warm[index], incremental=self._incremental[index])
            if index or first is None:  # a shifted pose is no warm start
                self._warm[index] = measured.rendering.warm
            first = first or measured
            for stage, milliseconds in measured.milliseconds.items():
                spent[stage] += milliseconds
            losses.append(measured.adversarial + penalty)
            if with_gradient:
                part, part_ms = _gradient(losses[-1], variable, 1.0 / len(poses), more=number < len(poses) - 1)
                gradient = part if gradient is None else gradient + part
                spent["backward"] += part_ms
        assert first is not None
        self._tried.append((self._problem.vehicle, code.detach().clone(), theta.detach().clone()))
        record = self._with_budget(self._record(code, theta, losses, gradient, first, spent), code, variable)
        self.trace.append(record)
        self.variables.append(variable.detach())
        if self._on_step is not None:
            self._on_step(record)
        return gradient

    def back(self) -> Tensor:
        """Return the point half way from the last variable to the held one."""
        return torch.lerp(self.held, self.variables[-1], 0.5)

    def result(self, kept: int, diverged: bool = False) -> AttackResult:
        """Build the result of the search. kept: number of the kept step, 0 if no step was valid."""
        status = "diverged" if diverged else "ok" if kept else "no_valid_step"
        return AttackResult(*self._tried[kept], kept, status, tuple(self.trace))

    def _with_budget(self, record: StepRecord, code: Tensor, variable: Tensor) -> StepRecord:
        """Return the record with the result of the budget check, if the check matters for this step."""
        lowest = record.loss < self._lowest
        if record.is_start or not record.valid or not (lowest or self._every_step):
            return record
        if self._search.natural is not None:
            start = time.perf_counter()
            within = self._search.natural(code.detach())
            spent = {"naturalness": 1e3 * (time.perf_counter() - start)}
            record = replace(record, within_budget=within, milliseconds=record.milliseconds | spent)
        if record.valid and lowest:
            self._lowest, self.held = record.loss, variable.detach()
        return record

    def _record(
        self,
        code: Tensor,
        theta: Tensor,
        losses: Sequence[Tensor],
        gradient: Tensor | None,
        measured: Measurement,
        spent: Mapping[str, float],
    ) -> StepRecord:
        rendering, (start, tried) = measured.rendering, (self._tried[0], self._tried[-1])
        loss = torch.stack([loss.detach() for loss in losses]).mean() if len(losses) > 1 else losses[0].detach()
        return StepRecord(
            step=len(self.trace),
            theta=tuple(theta.detach().tolist()),
            latent_distance=latent_distance(code, self._code0),
            loss=float(loss),
            adversarial_loss=float(measured.adversarial.detach()),
            proposal_score=measured.proposal_score,
            check=measured.check,
            unresolved_beams=rendering.unresolved_beams,
            max_residual_m=rendering.max_residual_m,
            evaluations=rendering.evaluations,
            grazing_gradient=None if gradient is None else rendering.grazing.gradient,
            least_slope=rendering.grazing.least_slope,
            non_finite=measured.non_finite
            + sum(count_non_finite(part) for part in (loss, gradient) if part is not None),
            is_start=tried[0] is start[0] and all(map(torch.equal, tried[1:], start[1:])),
            milliseconds=dict(spent),
        )


def _gradient(loss: Tensor, variable: Tensor, share: float, more: bool) -> tuple[Tensor, float]:
    """Compute share * dL/dv and the milliseconds it took; more: the graph is needed again."""
    start = time.perf_counter()
    if not loss.requires_grad:
        return torch.zeros_like(variable), 0.0
    (gradient,) = torch.autograd.grad(loss, variable, allow_unused=True, retain_graph=more)
    gradient = torch.zeros_like(variable) if gradient is None else gradient
    return gradient if share == 1.0 else share * gradient, 1e3 * (time.perf_counter() - start)
