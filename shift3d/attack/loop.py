"""Algorithm 1: projected gradient descent with a full re-rendering per step; the best valid step is kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.attack.trials import Search, SearchEvaluator


def descend(
    problem: AttackProblem,
    search: Search,
    steps: int,
    alpha: float,
    on_step: Callable[[StepRecord], None] | None = None,
    selection_window: int = 0,
) -> AttackResult:
    """Run plain gradient descent: v <- Proj[v - alpha dL/dv], `steps` times.

    The valid step with the lowest loss among steps 1..steps is kept. Without a valid step the start is returned, as
    best_step 0. After a step beyond the budget, or one without a gradient (for example if no beam meets the object),
    the next variable is half way back to the best so far. selection_window: see `best_step`.
    Source: SHIFT3D, Algorithm 1 (plain descent, 40 steps, alpha 0.01); the step back is our choice.
    """
    trials = SearchEvaluator(problem, search, on_step, every_step=selection_window > 0)
    variable = search.start.detach()
    for step in range(steps + 1):
        gradient = trials.evaluate(variable, step < steps)
        if gradient is None:
            break
        if trials.trace[-1].within_budget and bool(gradient.any()):
            variable = search.project(variable - alpha * gradient)
        else:
            variable = search.project(trials.back())
        if not bool(torch.isfinite(variable).all()):
            return trials.result(best_step(trials.trace, selection_window), diverged=True)
    return trials.result(best_step(trials.trace, selection_window))


def best_step(trace: Sequence[StepRecord], selection_window: int = 0) -> int:
    """Return the number of the valid step with the lowest loss, starts excluded: the first of several, 0 if none.

    selection_window: the loss of a step becomes the highest loss of the step and this many steps before and after it,
    which avoids a local minimum of one step. 0 is the paper's rule.
    Source: SHIFT3D, Algorithm 1; the neighbours are our choice. docs/why/experiments.md compares both rules over 100
    shape attacks.
    """
    best, lowest = 0, math.inf
    for step in range(1, len(trace)):
        near = [record.loss for record in trace[max(step - selection_window, 1) : step + selection_window + 1]]
        loss = float(np.max(near))  # NaN if one of the losses is NaN
        if trace[step].valid and not trace[step].is_start and loss < lowest:
            best, lowest = step, loss
    return best
