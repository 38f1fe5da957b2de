"""Transfer: puts a shape that was found in one scene into other scenes, and scores it there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from torch import Tensor

from shift3d.attack.problem import AttackProblem
from shift3d.attack.shape import SNAP_M, on_ground
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.task.assets import Assets
from shift3d.task.exchange import Row
from shift3d.task.problem import build_problem, placed_pose, with_other_vehicle
from shift3d.task.scoring import score_object
from shift3d.task.spec import TaskSpec, TransferScene
from shift3d.vehicles.vehicle import Vehicle

TaskAndProblem = tuple[TaskSpec, AttackProblem]
"""A task moved to another scene, and its problem there."""


def search_scene_places(spec: TaskSpec, assets: Assets) -> list[tuple[TaskSpec, Tensor]]:
    """Return the task in each further scene of a universal search, with its vehicle's pose (6,) in that scene.

    Scenes without room are left out. Raises: InputError: a scene that cannot be loaded, or that differs from the plan.
    """
    moved = (_moved(spec, other, assets) for other in spec.transfer_scenes[: spec.attack.search_scenes])
    return [(there, theta) for there in moved if (theta := placed_pose(there, assets)) is not None]


def search_scene_problems(spec: TaskSpec, problem: AttackProblem, assets: Assets) -> list[TaskAndProblem]:
    """Build a problem at each of `search_scene_places`. problem: the task's own; the problems share its detector."""
    places = search_scene_places(spec, assets)
    return [(there, replace(build_problem(there, assets, theta), detector=problem.detector)) for there, theta in places]


def score_transfers(spec: TaskSpec, assets: Assets, code: Tensor, vehicle: Vehicle | None = None) -> Iterator[Row]:
    """Score a code (d,) and its baseline at one place of each transfer scene that was not used in the search.

    vehicle: vehicle whose object frame renders the code; None: the task's vehicle.

    Yields: a row per scene and detector, scenes in the spec's order. Place and heading are random, drawn for the
    baseline under its own constraints; the shape is on the ground at the same x, y and heading. A scene without room
    gives a row without scores.
    Raises: InputError: a scene that cannot be loaded, or that differs from the plan.
    Source: SHIFT3D, Adversarial Shape Generation Results (10 distinct scenes, random yaw, the baseline under identical
    rotation and translation). That the height follows the shape is our choice, as in `attack.shape`.
    """
    for other in spec.transfer_scenes[spec.attack.search_scenes :]:
        yield from _put(_moved(spec, other, assets), other, assets, code, vehicle)


def _moved(spec: TaskSpec, other: TransferScene, assets: Assets) -> TaskSpec:
    """Move the task to another scene; the place there does not depend on the beams that see the task's own scene."""
    return spec.moved_to(other, assets.placement_scene(spec)[2])


def _put(moved: TaskSpec, other: TransferScene, assets: Assets, code: Tensor, vehicle: Vehicle | None) -> Iterator[Row]:
    known: Row = {"other_scene": other.scene, "effects": list(other.effects)}
    pose = placed_pose(moved, assets)
    if pose is None:
        yield from (known | {"scored_by": name, "status": "no_placement"} for name in moved.scored_by)
        return
    problem = build_problem(moved, assets, pose)
    others = assets.other_detectors(moved)
    radius_m = moved.attack.detection_radius_m
    there = with_other_vehicle(moved, assets, problem, vehicle)
    stands = on_ground(code, there, SNAP_M)
    before = score_object(problem, problem.code0, pose, radius_m, others)
    after = score_object(there, code, stands, radius_m, others)
    theta = [float(value) for value in pose]
    known |= {
        **dict(zip(POSE_COLUMNS, theta, strict=True)),
        "z_shape_m": float(stands[2]),
        "range_m": math.hypot(theta[0], theta[1]),
        "object_points_baseline": before.measurement.rendering.object_points,
        "object_points": after.measurement.rendering.object_points,
        "overlap_ok": after.measurement.check.overlap_ok,
        "contact_ok": after.measurement.check.contact_ok,
        "status": "ok",
    }
    for name in moved.scored_by:
        scores = {"score_baseline": before.results[name].score, "score": after.results[name].score}
        yield known | scores | {"scored_by": name}
