"""Ground truth of a case: renderings of two shapes by the preset `reference`, and the reference gradient."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.accuracy_time.cases import Case, case_problem
from shift3d.accuracy_time.errors import TrueHits, chord_lengths
from shift3d.accuracy_time.gradient import attack_step
from shift3d.accuracy_time.settings import Setting
from shift3d.attack.objective import (
    ATTACK_RADIUS_M,
    SCORE_RADIUS_M,
    detection_score,
    object_box,
    to_network_frame,
    window_around,
)
from shift3d.attack.problem import AttackProblem
from shift3d.detectors.base import Detector
from shift3d.render.culling import object_rays
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.store.arrays import read_arrays, write_arrays
from shift3d.task.assets import Assets
from shift3d.task.scoring import detections_near

SHAPES = ("start", "displaced")
"""Names of the two shapes: the vehicle, and the vehicle after a short attack."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of one case; dictionaries by shape.

    codes: (d,) float64 latent codes. hits: first hits and their chords. scores: final scores of the float64 detector.
    unresolved: number of beams that the reference could not decide. dz: (d,), dtheta: (6,) float64 gradient at "start".
    """

    codes: dict[str, Tensor]
    hits: dict[str, TrueHits]
    scores: dict[str, float]
    unresolved: dict[str, int]
    dz: Tensor
    dtheta: Tensor


def make_truth(case: Case, assets: Assets, reference: Setting, search: Setting, steps: int) -> Truth:
    """Render both shapes by the reference, and compute the gradient at the first.

    reference: the preset, with the widest detector window, so that narrower windows can be compared with it. search,
    steps: setting and length of the attack that displaces the shape; with 0 steps both shapes are equal.
    """
    problem = case_problem(case, assets, reference.accuracy)
    step = attack_step(problem, problem.code0, problem.theta0, reference.crop_m)
    searched = case_problem(case, assets, search.accuracy)
    spec = case.spec
    displaced = attacked_code(searched, spec.lambda_ or 0.0, spec.alpha, steps)
    moved = step.rendering
    if steps:
        with torch.no_grad():
            sdf = problem.field_of(displaced)
            moved = render(problem.beams, sdf, problem.theta0, problem.vehicle, problem.settings)
    truth = Truth({}, {}, {}, {}, step.dz.double(), step.dtheta.double())
    both = ((problem.code0.double(), step.rendering), (displaced, moved))
    for shape, (code, rendering) in zip(SHAPES, both, strict=True):
        truth.codes[shape], truth.hits[shape] = code, _hits(problem, code, rendering)
        radius_m = spec.attack.detection_radius_m
        truth.scores[shape] = score_of(problem, problem.detector, rendering, SCORE_RADIUS_M, radius_m)
        truth.unresolved[shape] = rendering.unresolved_beams
    return truth


@torch.no_grad()
def _hits(problem: AttackProblem, code: Tensor, rendering: Rendering) -> TrueHits:
    index = torch.nonzero(rendering.hit_mask).squeeze(1)
    rays, range_m = object_rays(problem.beams, index, problem.theta0), rendering.range_m[index]
    return TrueHits(index, range_m, chord_lengths(problem.metric(code), rays, range_m))


def attacked_code(problem: AttackProblem, lambda_: float, alpha: float, steps: int) -> Tensor:
    """Attack the shape for `steps` steps at a fixed pose; return the last code (d,) float64, valid or not."""
    code, warm, incremental = problem.code0.detach().clone(), None, problem.incremental_inference()
    for _ in range(steps):
        step = attack_step(problem, code, problem.theta0, ATTACK_RADIUS_M, warm, of_pose=False, incremental=incremental)
        warm = step.rendering.warm
        code = code - alpha * (step.dz + 2.0 * lambda_ * (code - problem.code0))
    return code.double()


def score_of(
    problem: AttackProblem, detector: Detector, rendering: Rendering, window_m: float | None, radius_m: float
) -> float:
    """Compute the final score of an existing rendering, as `task.scoring.score_object` does for its own rendering.

    detector: detector in the precision of scores. window_m: radius of the detector's window; None: the whole scene.
    radius_m: largest distance between the centres of the object and of a bounding box that detects it.
    """
    with torch.no_grad():
        points = to_network_frame(rendering.points.detach(), problem.ground_z_m)
        proposals = detector.proposals(points, window_around(detector, problem.theta0, window_m))
    box = object_box(problem.theta0, np.asarray(problem.vehicle.size_m), problem.ground_z_m)
    return detection_score(detections_near(proposals, box, radius_m), box, radius_m)


def write_truth(path: Path, truth: Truth) -> None:
    """Store the ground truth for a resumed run. Raises: InputError: a full or read-only disk."""
    arrays: dict[str, Any] = {"dz": truth.dz.numpy(), "dtheta": truth.dtheta.numpy()}
    for shape in SHAPES:
        arrays |= {f"{shape}.code": truth.codes[shape].numpy(), f"{shape}.score": np.float64(truth.scores[shape])}
        arrays |= {f"{shape}.{name}": values.numpy() for name, values in vars(truth.hits[shape]).items()}
        arrays[f"{shape}.unresolved"] = np.int64(truth.unresolved[shape])
    write_arrays(path, **arrays)


def read_truth(path: Path) -> Truth:
    """Load the ground truth that `write_truth` stored. Raises: InputError: a damaged file."""
    with read_arrays(path) as arrays:

        def tensor(name: str) -> Tensor:
            return torch.from_numpy(arrays[name])

        return Truth(
            {shape: tensor(f"{shape}.code") for shape in SHAPES},
            {s: TrueHits(*(tensor(f"{s}.{name}") for name in ("index", "range_m", "chord_m"))) for s in SHAPES},
            {shape: float(arrays[f"{shape}.score"]) for shape in SHAPES},
            {shape: int(arrays[f"{shape}.unresolved"]) for shape in SHAPES},
            tensor("dz"),
            tensor("dtheta"),
        )
