"""Baseline of a task: the unchanged vehicle at its place, with its scores and audit.

Tasks that differ in their search alone share the baseline. A worker that runs them one after another places, scores and
audits the vehicle once.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from shift3d.attack.problem import AttackProblem
from shift3d.task.assets import Assets
from shift3d.task.audit import Audit, score_and_audit
from shift3d.task.problem import build_problem, placed_pose
from shift3d.task.scoring import Candidate, ScoredObject
from shift3d.task.spec import TaskSpec

# A rendering of all beams is some 20 MB. Tasks of one place run one after another.
_KEPT = 2


@dataclass(frozen=True)
class Baseline:
    """Measured baseline of a task.

    found: the placed vehicle's problem, its scores and its audit; None if the scene has no place. milliseconds: by
    stage, without scoring; empty if an earlier task measured the baseline.
    """

    found: tuple[AttackProblem, ScoredObject, Audit | None] | None
    milliseconds: Mapping[str, float]

    def again(self) -> Baseline:
        """Return the same baseline for another task, with all times zero."""
        if self.found is None:
            return replace(self, milliseconds={})
        problem, scored, checked = self.found
        free = replace(scored, milliseconds={}), checked and replace(checked, milliseconds=0.0)
        return Baseline((problem, *free), {})


def baseline_candidate(problem: AttackProblem) -> Candidate:
    """Return the unchanged vehicle at its place."""
    return Candidate("baseline", 0, problem.code0, problem.theta0, best_step=0)


def baseline_of(spec: TaskSpec, assets: Assets) -> Baseline:
    """Return the baseline of a task; the bytes are the same whether this task or an earlier one measured it.

    Raises: InputError: a scene or vehicle that cannot be loaded, or that differs from the plan.
    """
    shared, kept = spec.baseline, assets.baselines
    if shared.task_id in kept:
        kept.move_to_end(shared.task_id)
        known: Baseline = kept[shared.task_id]
        return known
    measured = _measure(shared, assets)
    kept[shared.task_id] = measured.again()
    if len(kept) > _KEPT:
        kept.popitem(last=False)
    return measured


def _measure(spec: TaskSpec, assets: Assets) -> Baseline:
    start = time.perf_counter()
    theta = placed_pose(spec, assets)
    placed = time.perf_counter()
    spent = {"placement": 1e3 * (placed - start)}
    if theta is None:
        return Baseline(None, spent)
    problem = build_problem(spec, assets, theta)
    if spec.effects:  # once per scene: random draws, and weather on the scene's own points
        spent["effects_once"] = 1e3 * (time.perf_counter() - placed)
    return Baseline((problem, *score_and_audit(spec, assets, problem, baseline_candidate(problem))), spent)
