"""Measured cases: a vehicle at a distance in a scene, set up as in a task."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from shift3d.attack.problem import AttackProblem
from shift3d.detectors.scores_only import ScoresOnlyDetector
from shift3d.errors import InputError
from shift3d.placement.sampling import Placement
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.task.assets import Assets
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.spec import TaskSpec


@dataclass(frozen=True)
class Case:
    """One vehicle at one place.

    scenes: name of the scene set in the table. spec: spec of a shape task for this case; its accuracy is not used.
    theta: (6,) float64 pose, scene frame. beams: number of beams of the scene.
    """

    scenes: str
    spec: TaskSpec
    theta: Tensor
    beams: int

    @property
    def range_m(self) -> float:
        """Horizontal distance of the vehicle from the sensor."""
        return math.hypot(float(self.theta[0]), float(self.theta[1]))

    @property
    def name(self) -> str:
        """Readable name."""
        return f"{self.spec.vehicle} at {self.range_m:.1f} m in {self.spec.scene}"


def place_case(scenes: str, number: int, spec: TaskSpec, assets: Assets) -> Case:
    """Place the vehicle of `spec` within its placement's distances, in the first scene with room for it.

    number: number of the case. The search starts at the scene of this number, so that cases use different scenes if
    possible. Raises: InputError: no scene has room at these distances.
    """
    names = assets.scenes.names()
    for name in names[number % len(names) :] + names[: number % len(names)]:
        scene = assets.scenes.load(name)
        here = dataclasses.replace(spec, scene=name, dataset=scene.dataset, scene_hash=scene.content_hash())
        placed = place_vehicle(here, assets)
        if isinstance(placed, Placement):
            return Case(scenes, here, placed.theta, len(scene.points))
    where = f"{spec.placement.min_range_m:g} to {spec.placement.max_range_m:g} m"
    what = f"none of {len(names)} {scenes} scenes has room for {spec.vehicle} at {where}"
    raise InputError(what, "frontier.cases", "Give more scenes (scenes.count=20) or other distances")


def case_problem(
    case: Case, assets: Assets, accuracy: Mapping[str, Any], code: Tensor | None = None, grid: bool = False
) -> AttackProblem:
    """Set up the attack on a case as a task of this accuracy does, with the detector in the precision of the search.

    code: (d,) replaces the vehicle's latent code. grid: add an SDF grid of the code if the accuracy uses one.

    Raises: InputError: the detector gives no gradient.
    """
    settings = dict(accuracy) if grid else {**accuracy, "sdf_grid": False}
    spec = dataclasses.replace(case.spec, accuracy_settings=settings)
    problem = build_problem(spec, assets, case.theta)
    detector = assets.detector_of(spec.detector, str(accuracy["detector"]))
    if isinstance(detector, ScoresOnlyDetector):
        what = f"the frontier measures gradients, and {detector.where} gives none"
        raise InputError(what, f"detector={spec.detector}", "Give another detector=NAME")
    problem = dataclasses.replace(problem, detector=detector)
    if code is not None and not torch.equal(code := code.to(problem.code0.dtype), problem.code0):
        space = problem.space
        if space is not None:
            space = SdfGrid.of(problem.field_of(code.detach()), problem.vehicle, problem.settings)
        problem = dataclasses.replace(problem, code0=code, space=space)
    return problem
