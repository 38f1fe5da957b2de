"""The unchanged vehicle of a task: where it stands, and what the detectors make of it there.

Tasks that differ in their search alone share it. A worker that runs them one after the other places, scores and audits
the vehicle once.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from shift3d.attack.problem import AttackProblem
from shift3d.task.assets import Assets
from shift3d.task.audit import Audit, score_and_audit
from shift3d.task.problem import build_problem, placed_pose
from shift3d.task.scoring import Candidate, Scored
from shift3d.task.spec import TaskSpec

# A rendering of all beams is some 20 MB. Tasks of one place come one after the other.
_KEPT = 2


@dataclass(frozen=True)
class Baseline:
    """found: the placed vehicle before the detector, its scores and its audit; None where the scene has no place.

    milliseconds: by stage, scoring excluded; none where an earlier task has measured it.
    """

    found: tuple[AttackProblem, Scored, Audit | None] | None
    milliseconds: Mapping[str, float]

    def again(self) -> Baseline:
        """The same for another task, which spends nothing on it."""
        if self.found is None:
            return replace(self, milliseconds={})
        problem, scored, checked = self.found
        free = replace(scored, milliseconds={}), checked and replace(checked, milliseconds=0.0)
        return Baseline((problem, *free), {})


def baseline_candidate(problem: AttackProblem) -> Candidate:
    """The unchanged vehicle at its place."""
    return Candidate("baseline", 0, problem.code0, problem.theta0, best_step=0)


def baseline_of(spec: TaskSpec, assets: Assets) -> Baseline:
    """The baseline of a task: the bytes are the same whether this or an earlier task has measured it.

    Raises: InputError: a scene or vehicle that cannot be loaded, or is not what the task was planned with.
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
    if spec.effects:  # what they do once: draws, and weather on the scene's own points
        spent["effects_once"] = 1e3 * (time.perf_counter() - placed)
    return Baseline((problem, *score_and_audit(spec, assets, problem, baseline_candidate(problem))), spent)
