"""Rescoring of one object: as in the sweep, at reference accuracy, with noise, and near its pose."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from shift3d.attack.problem import AttackProblem
from shift3d.detectors.base import Detector
from shift3d.render.rendering import Rendering
from shift3d.seeding import generator
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.task.assets import Assets
from shift3d.task.differences import Differences, differences
from shift3d.task.problem import build_problem
from shift3d.task.scoring import SCORED_NEARBY, NoisyCopyScorer, ScoredObject, score_object, score_points, timed
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.vehicle import Vehicle

RANGE_NOISE_M = 0.02
"""Standard deviation of the noise on beams that hit the object: the figure of common spinning sensors."""
NEARBY_SIGMA = (0.01, 0.01, 0.0017453292519943296)
"""Standard deviations of x and y (1 cm) and yaw (0.1 degrees): the best accuracy of a scene's pose."""
DRAWS = 2
"""Number of draws of noise, and of nearby poses."""


@dataclass(frozen=True)
class Solution:
    """One row of ``solutions.parquet`` with its scores.

    code: (d,) float32. theta: (6,) float64. scores: by the detector's name, as the sweep reported them. vehicle:
    vehicle whose object frame renders the code; None: the task's vehicle.
    """

    method: str
    replicate: int
    code: Tensor
    theta: Tensor
    scores: Mapping[str, float]
    vehicle: Vehicle | None = None


@dataclass(frozen=True)
class VerificationResult:
    """Verification results of one object. Scores are by the detector's name, and per draw for `noise` and `nearby`."""

    again: dict[str, float]
    reference: dict[str, float]
    noise: dict[str, list[float]]
    nearby: dict[str, list[float]]
    found: Differences
    unresolved: int
    unresolved_reference: int
    milliseconds: dict[str, float]


@dataclass(frozen=True)
class VerificationProblems:
    """Problems of one scene at the sweep's accuracy and at reference accuracy, with the other detectors."""

    standard: AttackProblem
    reference: AttackProblem
    others: Mapping[str, Detector]
    others_reference: Mapping[str, Detector]
    nearby: NoisyCopyScorer = field(default_factory=NoisyCopyScorer)

    @staticmethod
    def of(spec: TaskSpec, assets: Assets, solution: Solution) -> VerificationProblems:
        """Build the task's problems, with a solution's vehicle at its pose.

        Raises: InputError: a scene or vehicle that cannot be loaded, or that differs from the plan.
        """
        settings = accuracy_settings(AccuracyConfig(name="reference", render={}))
        reference = dataclasses.replace(spec, accuracy="reference", accuracy_settings=settings)
        others, others_reference = assets.other_detectors(spec), assets.other_detectors(reference)
        theta, vehicle = solution.theta, solution.vehicle
        problem, true_problem = (build_problem(which, assets, theta, vehicle) for which in (spec, reference))
        return VerificationProblems(problem, true_problem, others, others_reference)


def verify_object(spec: TaskSpec, solution: Solution, problems: VerificationProblems) -> VerificationResult:
    """Render and score one object in all four ways; a baseline and its solution get the same draws, by placement."""
    spent: dict[str, float] = {}
    radius_m = spec.attack.detection_radius_m
    nearby = problems.nearby if solution.method in SCORED_NEARBY else None
    with timed(spent, "again"):
        again = _score(problems.standard, solution.code, solution.theta, radius_m, problems.others, nearby)
    problems.nearby.note(solution.method, again)
    with timed(spent, "reference"):
        true = _score(problems.reference, solution.code, solution.theta, radius_m, problems.others_reference)
    everyone = {problems.standard.detector.name: problems.standard.detector, **problems.others}
    with timed(spent, "noise"):
        noisy = [
            score_points(problems.standard, points, solution.theta, radius_m, everyone)
            for points in _noisy_points(spec, problems.standard, again.measurement.rendering)
        ]
    with timed(spent, "nearby"):
        near = [
            _score(problems.standard, solution.code, theta, radius_m, problems.others)
            for theta in _nearby(spec, solution.theta)
        ]
    found, truth = again.measurement.rendering.first_hits, true.measurement.rendering.first_hits
    return VerificationResult(
        again=_scores(again),
        reference=_scores(true),
        noise={name: [draw[name].score for draw in noisy] for name in again.results},
        nearby={name: [draw.results[name].score for draw in near] for name in again.results},
        found=differences((found.hit_mask, found.range_m), (truth.hit_mask, truth.range_m)),
        unresolved=found.unresolved_beams,
        unresolved_reference=truth.unresolved_beams,
        milliseconds=spent,
    )


def _score(
    problem: AttackProblem,
    code: Tensor,
    theta: Tensor,
    radius_m: float,
    others: Mapping[str, Detector],
    nearby: NoisyCopyScorer | None = None,
) -> ScoredObject:
    return score_object(problem, code.to(problem.settings.dtype), theta, radius_m, others, nearby)


def _scores(scored: ScoredObject) -> dict[str, float]:
    return {name: result.score for name, result in scored.results.items()}


def _noisy_points(spec: TaskSpec, problem: AttackProblem, rendering: Rendering) -> Iterator[Tensor]:
    """Yield scenes with new noise along the beams on the object; all other points already have sensor noise."""
    directions, hit = problem.cast_beams.directions, rendering.hit_mask
    for draw in range(DRAWS):
        # Drawn for every beam of the scene, so that a beam's noise does not depend on the object that it hits.
        drawn = generator("verify noise", spec.placement_seed, draw).standard_normal(len(hit))
        noise = RANGE_NOISE_M * torch.from_numpy(drawn)[hit]
        points = rendering.points.clone()
        points[hit] = (points[hit].double() + noise[:, None] * directions[hit]).to(points.dtype)
        yield points


def _nearby(spec: TaskSpec, theta: Tensor) -> Iterator[Tensor]:
    """Yield poses near theta, at the same height."""
    for draw in range(DRAWS):
        offset = generator("verify nearby", spec.placement_seed, draw).standard_normal(3) * NEARBY_SIGMA
        moved = theta.clone()
        moved[[0, 1, 3]] += torch.from_numpy(offset)
        yield moved
