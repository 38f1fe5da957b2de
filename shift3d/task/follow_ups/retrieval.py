"""Retrieval: the vehicle of a pool nearest to a solution, and control vehicles, scored in the solution's place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shift3d.attack.shape import SNAP_M, on_ground
from shift3d.detectors.base import Detector
from shift3d.retrieval.pool import Pool, excluded
from shift3d.retrieval.reconstruction import vehicle_of
from shift3d.store.resolve import as_location
from shift3d.store.tables import read_table
from shift3d.task.exchange import AssetsSpec, Row, TaskResult
from shift3d.task.follow_ups.rescoring import Solution
from shift3d.task.follow_ups.verify import VerifyAssets, load_verify_assets
from shift3d.task.problem import build_problem
from shift3d.task.scoring import score_object
from shift3d.task.spec import TaskSpec

CONTROLS = 3
"""Number of control vehicles scored beside the retrieved vehicle."""


@dataclass(frozen=True)
class RetrievalAssets:
    """Assets of a worker: the sweep's assets and solutions, and the pool."""

    held: VerifyAssets
    pool: Pool


def load_retrieval_assets(spec: AssetsSpec) -> RetrievalAssets:
    """Load the shared assets of the tasks; the pool is one of the sweep's final tables.

    Raises: InputError as `load_assets`, and for a pool that is missing, damaged or empty.
    """
    held = load_verify_assets(spec)
    path = as_location(str(spec.results)) / "vehicle_pool.parquet"
    return RetrievalAssets(held, Pool.of(read_table(path, "vehicle_pool").to_pydict(), str(path)))


def retrieval_task(spec: TaskSpec, held: RetrievalAssets) -> TaskResult:
    """Score the pool's vehicle nearest to a task's adversarial shape, and its controls: a row per vehicle and detector.

    Gives no rows for a pose task, or if nothing could be placed.
    Raises: InputError: tables, a scene or a vehicle that cannot be loaded, or that are not those of the sweep.
    Source: SHIFT3D, supplement, 'Retrieving the Nearest Match'; controls are our choice.
    """
    solutions = {(found.method, found.replicate): found for found in held.held.solutions(spec)}
    solution = solutions.get(("adversarial", 0))
    if solution is None or spec.mode == "pose":
        return TaskResult()
    before = solutions["baseline", 0].scores
    code = solution.code.double().numpy()
    nearest, distance = held.pool.nearest(code)
    others = held.held.assets.other_detectors(spec)
    rows: list[Row] = []
    chosen = [("retrieved", nearest), *(("control", index) for index in held.pool.controls(nearest, CONTROLS))]
    for number, (role, index) in enumerate(chosen):
        kin = held.pool.rows[index]
        known = {
            "role": role,
            "replicate": max(number - 1, 0),
            "pool_dataset": kin["dataset"],
            "pool_scene": kin["scene"],
            "pool_label": kin["label"],
            "pool_score": kin["score"],
            "pool_range_m": kin["range_m"],
            "pool_points": kin["points"],
            "latent_distance": float(np.linalg.norm(held.pool.codes[index] - code)),
            "excluded": excluded(code, distance),
        }
        scored = _scored(spec, held, kin, solution, others)
        rows += [
            known | scored[name] | {"score_baseline": before[name], "score_solution": solution.scores[name]}
            for name in spec.scored_by
        ]
    return TaskResult(retrieved=rows)


def _scored(
    spec: TaskSpec, held: RetrievalAssets, kin: dict[str, Any], solution: Solution, others: dict[str, Detector]
) -> dict[str, Row]:
    """Score a vehicle of the pool at a solution's pose, on the ground. Returns results by the detector's name."""
    assets = held.held.assets
    own, code = solution.vehicle or assets.vehicle(spec), np.array(kin["latent_code"], np.float32)
    # Made from the code, not from coordinates: those refer to the pool's vehicle set, which may not be the sweep's.
    name = f"{kin['scene']}/{kin['label']}"
    vehicle = vehicle_of(name, assets.decoder, code, kin["scale_m"], own.sdf_R_object)
    theta = solution.theta.clone()
    theta[2] += (vehicle.size_m[2] - own.size_m[2]) / 2
    problem = build_problem(spec, assets, theta, vehicle)
    stands = on_ground(problem.code0, problem, SNAP_M)
    found = score_object(problem, problem.code0, stands, spec.attack.detection_radius_m, others)
    check = found.measurement.check
    same = {
        "object_points": found.measurement.rendering.object_points,
        "overlap_ok": check.overlap_ok,
        "contact_ok": check.contact_ok,
    }
    return {name: same | {"scored_by": name, "score": result.score} for name, result in found.results.items()}
