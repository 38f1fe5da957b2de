"""Gradient-free searches: random draws and evolution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.loop import best_step
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.attack.trials import FREE_DISTANCE, Family, Search, SearchEvaluator

SIGMA = 0.3
"""Initial standard deviation of an evolution, in the variable's units (our choice)."""


def search_by_draws(
    problem: AttackProblem,
    search: Search,
    evaluations: int,
    rng: np.random.Generator,
    distance: float = FREE_DISTANCE,
    family: Family | None = None,
) -> AttackResult:
    """Return the best of `evaluations` random draws, as a comparison for a search.

    evaluations: draws after the baseline, which is step 0 and does not count. distance: see `Search.draw`. family:
    kinds, one at random for each draw; None: the search's own draws. If a draw would be the best but lies beyond the
    budget, the next candidate is half way back to the best so far.
    Returns: the valid draw with the lowest loss. Source: our choice: the paper's random objects are one draw each.
    """
    trials = SearchEvaluator(problem, search, differentiable=False)
    trials.evaluate(search.start, False)
    for _ in range(evaluations):
        within = trials.trace[-1].within_budget
        if within and family is not None:
            problem, search = family.of(int(rng.integers(len(family.order))))
            trials.switch_kind(problem, search)
        trials.evaluate(search.draw(rng, distance) if within else search.project(trials.back()), False)
    return trials.result(best_step(trials.trace))


def evolve(problem: AttackProblem, search: Search, evaluations: int, rng: np.random.Generator) -> AttackResult:
    """Run CMA-ES from the baseline on the loss alone; candidates beyond the hard constraints are projected first.

    An invalid candidate ranks behind every valid one of its generation.
    Args: evaluations: renderings after the baseline's; a last generation that is cut short does not update the
    strategy. rng: the only source of randomness.
    Returns: the valid step with the lowest loss.
    Source: Hansen 2016, by the cma package; ranking by validity is our choice.
    """
    import cma

    trials = SearchEvaluator(problem, search, differentiable=False)
    trials.evaluate(search.start, False)
    start = search.start.detach().double().numpy()
    options: dict[str, Any] = {
        "seed": math.nan,  # randn supplies the random numbers; numpy's global state is not touched
        "randn": lambda count, length: rng.standard_normal((count, length)),
        "verbose": -9,
        "maxiter": math.inf,
    }
    strategy = cma.CMAEvolutionStrategy(start, SIGMA, options)
    left = evaluations
    while left > 0:
        candidates = strategy.ask()
        tried = [_projected(search, vector) for vector in candidates[:left]]
        for variable in tried:
            trials.evaluate(variable, False)
        left -= len(tried)
        if len(tried) == len(candidates):
            strategy.tell([variable.double().numpy() for variable in tried], _ranked(trials.trace[-len(tried) :]))
    return trials.result(best_step(trials.trace))


def _projected(search: Search, vector: np.ndarray) -> Tensor:
    return search.project(torch.from_numpy(np.asarray(vector, np.float64)).to(search.start.dtype))


def _ranked(records: list[StepRecord]) -> list[float]:
    """Rank the members of a generation, best first: valid members by loss, then invalid members by loss.

    A NaN loss, which would leave the order undefined, ranks as infinite.
    """
    loss = [math.inf if math.isnan(record.loss) else record.loss for record in records]
    order = sorted(range(len(records)), key=lambda index: (not records[index].valid, loss[index], index))
    places = [0.0] * len(records)
    for place, index in enumerate(order):
        places[index] = float(place)
    return places
