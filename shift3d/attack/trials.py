"""What every search does over and over: make an object of a variable, render it, ask the detector, note the step."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.objective import latent_distance
from shift3d.attack.problem import AttackProblem, Measurement, count_non_finite, measure
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.render.solvers.search import WarmStart

__all__ = ["Parameters", "Search", "Trials"]

Parameters = Callable[[Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class Search:
    """What is searched, whatever searches it.

    start: first value of the variable. parameters: variable -> (code, theta). penalty: variable -> scalar added
    to the loss. project: variable -> nearest variable that satisfies the hard constraints. draw: (generator, latent
    distance) -> a variable at random among those that the search may visit; where these have no bound, as codes of the
    free space have none, one at that distance from the start.
    """

    mode: Literal["shape", "pose", "shape_pose"]
    start: Tensor
    parameters: Parameters
    penalty: Callable[[Tensor], Tensor]
    project: Callable[[Tensor], Tensor]
    draw: Callable[[np.random.Generator, float], Tensor]


class Trials:
    """The evaluations of one search, in their order.

    Renderings start from the last one's hits, and the detector computes again only what a move has changed.
    differentiable: False for searches that never ask for a gradient; nothing is then kept for one.
    """

    def __init__(
        self,
        problem: AttackProblem,
        search: Search,
        on_step: Callable[[StepRecord], None] | None = None,
        differentiable: bool = True,
    ) -> None:
        self.trace: list[StepRecord] = []
        self.variables: list[Tensor] = []
        self._problem, self._search, self._on_step = problem, search, on_step
        self._differentiable = differentiable
        self._tried: list[tuple[Tensor, Tensor]] = []
        self._warm: WarmStart | None = None
        self._incremental = problem.incremental_inference()

    def evaluate(self, variable: Tensor, with_gradient: bool, shifts: Sequence[Tensor] = ()) -> Tensor | None:
        """Try a variable and note it as the next step; returns the loss' gradient, None where none is asked for.

        shifts: changes of the pose, (6,) each; where some are given, loss and gradient are their mean. Whether the step
        is valid is asked of the pose itself, which is measured first and counts as one of them.
        A loss that does not depend on the variable (no hit, no overlapping proposal) has the gradient 0.
        """
        variable = variable.detach().clone().requires_grad_(self._differentiable)
        code, theta = self._search.parameters(variable)
        penalty = self._search.penalty(variable)
        share = 1.0 / (1 + len(shifts))
        measured = measure(self._problem, code, theta, self._warm, incremental=self._incremental)
        self._warm = measured.rendering.warm
        losses = [measured.adversarial + penalty]
        gradient, spent_ms = _gradient(losses[0], variable, share, more=bool(shifts)) if with_gradient else (None, 0.0)
        for index, shift in enumerate(shifts):
            moved = measure(self._problem, code, theta + shift, self._warm, incremental=self._incremental)
            losses.append(moved.adversarial + penalty)
            if gradient is not None:
                part, part_ms = _gradient(losses[-1], variable, share, more=index < len(shifts) - 1)
                gradient, spent_ms = gradient + part, spent_ms + part_ms
        record = self._record(code, theta, losses, gradient, measured, spent_ms)
        self.trace.append(record)
        self.variables.append(variable.detach())
        self._tried.append((code.detach().clone(), theta.detach().clone()))
        if self._on_step is not None:
            self._on_step(record)
        return gradient

    def result(self, kept: int, diverged: bool = False) -> AttackResult:
        """The search's answer. kept: the step that is kept, 0 where no step was valid."""
        status = "diverged" if diverged else "ok" if kept else "no_valid_step"
        return AttackResult(self._search.mode, *self._tried[kept], kept, status, tuple(self.trace))

    def _record(
        self,
        code: Tensor,
        theta: Tensor,
        losses: Sequence[Tensor],
        gradient: Tensor | None,
        measured: Measurement,
        backward_ms: float,
    ) -> StepRecord:
        rendering = measured.rendering
        loss = torch.stack([loss.detach() for loss in losses]).mean() if len(losses) > 1 else losses[0].detach()
        return StepRecord(
            step=len(self.trace),
            theta=tuple(theta.detach().tolist()),
            latent_distance=latent_distance(code, self._problem.code0),
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
            milliseconds={**measured.milliseconds, "backward": backward_ms},
        )


def _gradient(loss: Tensor, variable: Tensor, share: float, more: bool) -> tuple[Tensor, float]:
    """share * dL/dv and the milliseconds it took; more: the graph is needed again."""
    start = time.perf_counter()
    if not loss.requires_grad:
        return torch.zeros_like(variable), 0.0
    (gradient,) = torch.autograd.grad(loss, variable, allow_unused=True, retain_graph=more)
    gradient = torch.zeros_like(variable) if gradient is None else gradient
    return gradient if share == 1.0 else share * gradient, 1e3 * (time.perf_counter() - start)
