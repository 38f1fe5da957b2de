"""Runs one task: places the vehicle, attacks it, scores the solution and the objects for comparison."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.baselines import noise_codes, random_code, random_pose
from shift3d.attack.problem import AttackProblem
from shift3d.attack.records import AttackResult
from shift3d.attack.shape import SNAP_M, on_ground
from shift3d.attack.trials import FREE_DISTANCE
from shift3d.detectors.base import Detector
from shift3d.naturalness.measure import NaturalnessMeasure
from shift3d.seeding import generator
from shift3d.task.assets import Assets, search_precision
from shift3d.task.audit import score_and_audit
from shift3d.task.baseline import baseline_candidate, baseline_of
from shift3d.task.exchange import TaskResult
from shift3d.task.problem import with_other_vehicle
from shift3d.task.rows import Rows
from shift3d.task.scoring import Candidate, NoisyCopyScorer
from shift3d.task.searching import best_of_draws, edited_vehicle, pose_limits, search_task
from shift3d.task.spec import TaskSpec
from shift3d.task.transfer import score_transfers, search_scene_places
from shift3d.vehicles.vehicle import Vehicle


def run_task(spec: TaskSpec, assets: Assets) -> TaskResult:
    """Run one task.

    The result is a pure function of the spec and the content that its hashes name, on one thread: the same bytes on
    every machine. A scene with no place for the vehicle gives rows with status "no_placement" and no score.
    Raises: InputError: a scene or vehicle that cannot be loaded, or that differs from the plan.
    Source: SHIFT3D Algorithm 1, sections Setup and Evaluation Metrics.
    """
    start = time.perf_counter()
    rows = Rows(spec)
    baseline = baseline_of(spec, assets)
    for stage, milliseconds in baseline.milliseconds.items():
        rows.time("baseline", stage, milliseconds)
    if baseline.found is None:
        for method, replicate in _planned(spec):
            rows.skip(method, replicate, "no_placement")
    else:
        problem, scored, checked = baseline.found
        unchanged = baseline_candidate(problem)
        rows.add(unchanged, problem.code0, scored, checked, _naturalness(spec, assets, unchanged, rows))
        searched = assets.detector_of(spec.detector, search_precision(spec))
        nearby = NoisyCopyScorer()
        for candidate in _candidates(spec, problem, searched, assets, rows):
            there = with_other_vehicle(spec, assets, problem, candidate.vehicle)
            known = replace(scored, milliseconds={}) if candidate.is_same_object(unchanged) else None
            found, checked = score_and_audit(spec, assets, there, candidate, nearby, known)
            nearby.note(candidate.method, found)
            rows.add(candidate, problem.code0, found, checked, _naturalness(spec, assets, candidate, rows))
            if spec.transfer_scenes and candidate.method == "adversarial":
                began = time.perf_counter()
                rows.transfers(score_transfers(spec, assets, candidate.code, candidate.vehicle))
                elsewhere = len(spec.transfer_scenes) - spec.attack.search_scenes
                rows.time("adversarial", "transfers", 1e3 * (time.perf_counter() - began), elsewhere)
        for method, replicate in _planned(spec):
            rows.skip(method, replicate, "no_random_pose")
    rows.time("adversarial", "total", 1e3 * (time.perf_counter() - start))
    return rows.result()


def _naturalness(spec: TaskSpec, assets: Assets, candidate: Candidate, rows: Rows) -> NaturalnessMeasure | None:
    """Measure a candidate's naturalness; None for noisy copies, and if the task measures none."""
    if candidate.method == "adversarial_noise" or (measures := assets.naturalness(spec)) is None:
        return None
    vehicle, code = candidate.vehicle or assets.vehicle(spec), candidate.code.detach().float()
    if candidate.vehicle is None and torch.equal(code, torch.from_numpy(vehicle.latent_code)):
        return assets.naturalness_of(spec, spec.vehicle)
    start = time.perf_counter()
    found = measures.of_code(vehicle, assets.decoder, code)
    rows.time(candidate.method, "naturalness", 1e3 * (time.perf_counter() - start))
    return found


def _planned(spec: TaskSpec) -> Iterator[tuple[str, int]]:
    """Yield every (method, replicate) that a task reports in any case."""
    yield "baseline", 0
    yield from (("random", i) for i in range(spec.attack.random_replicates))
    if spec.attack.random_search:
        yield "random_budget", 0
    if spec.attack.edit and spec.mode != "pose":
        yield "edited", 0
    yield "adversarial", 0
    if spec.mode != "pose":
        yield from (("adversarial_noise", i) for i in range(spec.attack.noise_replicates))


def _candidates(
    spec: TaskSpec, problem: AttackProblem, searched: Detector, assets: Assets, rows: Rows
) -> Iterator[Candidate]:
    """Yield random objects, the adversarial object and its noisy copies, in the order of the tables.

    searched: the detector at the precision of the search.
    """
    if spec.attack.search_scenes:
        began = time.perf_counter()
        places = search_scene_places(spec, assets)
        rows.time("adversarial", "search_scenes", 1e3 * (time.perf_counter() - began), len(places))
    found = search_task(spec, replace(problem, detector=searched), assets)
    rows.attack(found)
    code, theta, vehicle = found.latent_code, found.theta, _other_than(problem, found)
    there = with_other_vehicle(spec, assets, problem, vehicle)
    distance = float((code.double() - problem.code0.double()).norm())
    rng = generator("random", spec.task_id)
    for index in range(spec.attack.random_replicates):
        if (drawn := _random(spec, problem, distance, rng)) is not None:
            yield Candidate("random", index, *drawn)
    if spec.attack.random_search:
        best = best_of_draws(spec, replace(problem, detector=searched), assets, distance or FREE_DISTANCE)
        rows.search_time("random_budget", best)
        drawn_as = _other_than(problem, best)
        yield Candidate("random_budget", 0, best.latent_code, best.theta, best.best_step, best.status, drawn_as)
    if spec.attack.edit and spec.mode != "pose":
        edited = edited_vehicle(spec, problem, assets)
        yield Candidate("edited", 0, edited, on_ground(edited, problem, SNAP_M))
    yield Candidate("adversarial", 0, code, theta, found.best_step, found.status, vehicle)
    if spec.mode != "pose":
        # A noisy copy is placed at the solution's place, on the ground under its own shape.
        there = there if spec.mode == "shape" else replace(there, theta0=theta)
        rng = generator("noise", spec.task_id)
        sigma = spec.attack.noise_share * distance if spec.attack.noise_share else spec.attack.noise_sigma
        noisy = noise_codes(code, sigma, spec.attack.noise_replicates, rng)
        for index, noisy_code in enumerate(noisy):
            stands = on_ground(noisy_code, there, SNAP_M)
            yield Candidate("adversarial_noise", index, noisy_code, stands, vehicle=vehicle)


def _other_than(problem: AttackProblem, found: AttackResult) -> Vehicle | None:
    """Return the vehicle of another kind that a search switched to; None if it kept the task's own."""
    return None if found.vehicle is problem.vehicle else cast(Vehicle, found.vehicle)


def _random(
    spec: TaskSpec, problem: AttackProblem, distance: float, rng: np.random.Generator
) -> tuple[Tensor, Tensor] | None:
    """Draw a shape at the solution's latent distance, a pose within its limits, or both; None if no pose is valid."""
    if spec.mode == "pose":
        drawn = random_pose(problem, rng, pose_limits(spec))
        return None if drawn is None else (problem.code0, drawn)
    code = random_code(problem.code0, distance, rng)
    if spec.mode == "shape":
        return code, on_ground(code, problem, SNAP_M)
    drawn = random_pose(replace(problem, code0=code, space=None), rng, pose_limits(spec))
    return None if drawn is None else (code, drawn)
