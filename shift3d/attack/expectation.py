"""Descent on the expected loss over small placement changes, with adaptive steps and several starts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.loop import best_step
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.trials import FREE_DISTANCE, Family, Search, SearchEvaluator

SHIFT_M, TURN_RAD = 0.1, 0.02
"""Standard deviations of the placement changes in the mean loss: the grid spacing of the beams, and a degree."""
MOMENTA = (0.8, 0.95)
"""Moments of Adam; for some twenty steps the usual 0.9 and 0.999 are too slow."""
BEST_KINDS = 3
"""Number of kinds, the best of the first half of the starts, that the second half is drawn from."""


def descend_expectation(
    problem: AttackProblem,
    search: Search,
    evaluations: int,
    rate: float,
    rng: np.random.Generator,
    placements: int = 2,
    starts: int = 1,
    family: Family | None = None,
) -> AttackResult:
    """Minimize the mean loss over nearby placements with projected Adam.

    A loss has a local minimum wherever beams happen to hit the shape; a loss that is low on average over placements is
    low because of the shape.

    Args:
        evaluations: renderings in total, shared by starts and placements; the baseline's is not counted.
        rate: Adam's, in the variable's units; falls to a tenth.
        rng: draws the placements and the further starts.
        placements: number of placements in the mean, the object's own among them; new draws in every step.
        starts: the baseline, then draws from the space, one evaluation each; the descent begins at the best start.
        family: kinds for the draws. The first half takes one draw from each kind, in order; the second half takes turns
            among the three kinds with the lowest losses. The descent uses the best start's kind. None: the search's own
            draws.
    Returns: the valid step with the lowest loss of all; a draw has its own loss, a step of the descent the mean loss.
    Source: expectation over transformation (Athalye et al. 2018) with Adam (Kingma and Ba 2015); our choice.
    """
    trials = SearchEvaluator(problem, search)
    if starts > 1:
        search = _select_best_start(trials, problem, search, starts, rng, family)
    variable = trials.held
    steps = max(0, (evaluations - (starts - 1)) // placements)
    mean, square = torch.zeros_like(variable, dtype=torch.float64), torch.zeros_like(variable, dtype=torch.float64)
    # Without further starts the baseline is the first step of the descent.
    moves = steps if starts == 1 else steps - 1
    for move in range(moves + 1):
        shifts = [_shift(rng) for _ in range(placements - 1)]
        gradient = trials.evaluate(variable, move < moves, shifts)
        if gradient is None:
            break
        direction, mean, square = _adam(gradient.double(), mean, square, move)
        size = rate * (1.0 - 0.9 * move / steps)
        if trials.trace[-1].within_budget:
            variable = search.project(variable - (size * direction).to(variable.dtype))
        else:
            variable = search.project(trials.back())
        if not bool(torch.isfinite(variable).all()):
            return trials.result(best_step(trials.trace), diverged=True)
    return trials.result(best_step(trials.trace))


def _select_best_start(
    trials: SearchEvaluator,
    problem: AttackProblem,
    search: Search,
    starts: int,
    rng: np.random.Generator,
    family: Family | None,
) -> Search:
    """Evaluate the baseline and the draws, then switch to the kind of the best; returns that kind's search."""
    trials.evaluate(search.start, False)
    kinds, lowest = [(problem, search)], dict[int, float]()
    turns = _turns(family.order if family else (), starts - 1, lowest)
    number: int | None = None
    for _ in range(starts - 1):
        within = trials.trace[-1].within_budget
        if within and family is not None:
            number = next(turns)
            problem, search = family.of(number)
            trials.switch_kind(problem, search)
        variable = search.draw(rng, FREE_DISTANCE) if within else search.project(trials.back())
        kinds.append((problem, search))
        trials.evaluate(variable, False)
        if number is not None and trials.trace[-1].valid:
            lowest[number] = min(lowest.get(number, math.inf), trials.trace[-1].loss)
    best = best_step(trials.trace)
    best = best if trials.trace[best].loss < trials.trace[0].loss else 0
    if kinds[best][1] is not search:
        trials.switch_kind(*kinds[best])
    trials.held = trials.variables[best]
    return kinds[best][1]


def _turns(order: Sequence[int], draws: int, lowest: Mapping[int, float]) -> Iterator[int]:
    """Yield the kind of each draw. lowest: loss of each kind with a valid draw, read after the first half."""
    yield from order[: math.ceil(draws / 2)]
    yield from itertools.cycle(sorted(lowest, key=lowest.__getitem__)[:BEST_KINDS] or order)


def _shift(rng: np.random.Generator) -> Tensor:
    x, y, yaw = rng.standard_normal(3) * (SHIFT_M, SHIFT_M, TURN_RAD)
    return torch.tensor([x, y, 0.0, yaw, 0.0, 0.0], dtype=torch.float64)


def _adam(gradient: Tensor, mean: Tensor, square: Tensor, step: int) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the step's direction, about 1 in each coordinate, and the new moments."""
    mean = MOMENTA[0] * mean + (1 - MOMENTA[0]) * gradient
    square = MOMENTA[1] * square + (1 - MOMENTA[1]) * gradient.square()
    root = (square / (1 - MOMENTA[1] ** (step + 1))).sqrt()
    direction = (mean / (1 - MOMENTA[0] ** (step + 1))) / root.clamp_min(torch.finfo(torch.float64).tiny)
    return direction, mean, square
