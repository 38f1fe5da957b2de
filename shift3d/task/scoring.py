"""Scoring: the detectors' scores and losses for one object, and its constraint check."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.attack.objective import (
    SCORE_RADIUS_M,
    adversarial_loss,
    detection_score,
    is_near,
    object_box,
    to_network_frame,
)
from shift3d.attack.problem import AttackProblem, Measurement, measure
from shift3d.detectors.base import BevWindow, Detections, Detector, Proposals
from shift3d.detectors.incremental.inference import IncrementalInference, UncachedInference, incremental_inference
from shift3d.detectors.nms import suppress
from shift3d.render.solvers.search import WarmStart
from shift3d.vehicles.vehicle import Vehicle

# Scores below this count as 0: their boxes are not even candidates for suppression. Recall curves cover [0, 1], so the
# detector's own cut-off for display (0.1) would put a step into them. Our choice.
SCORE_FLOOR = 0.01
# IoU threshold of suppression. Source: the public Waymo config.
SUPPRESSION_IOU = 0.25
# A box centred farther away suppresses no box near the object, and none that could. Covers the corners of every window.
_AROUND_M = 2.0 * SCORE_RADIUS_M
# Methods with many candidates at one place that differ little from the solution: see `NoisyCopyScorer`.
SCORED_NEARBY = ("adversarial_noise",)


@dataclass(frozen=True)
class Candidate:
    """One object to be scored: a code and a pose, and their origin.

    vehicle: vehicle whose object frame renders the code; None: the task's vehicle.
    """

    method: str
    replicate: int
    code: Tensor
    theta: Tensor
    best_step: int | None = None
    status: str = "ok"
    vehicle: Vehicle | None = None

    def is_same_object(self, other: Candidate) -> bool:
        """True if latent code, pose and frame equal those of `other` bit for bit."""
        same = torch.equal(self.code, other.code) and torch.equal(self.theta, other.theta)
        return same and self.vehicle is other.vehicle


@dataclass(frozen=True)
class DetectorResult:
    """One detector's result for an object.

    score: of the best box after suppression within the detection radius, 0 if none. adversarial_loss: L_adv.
    """

    score: float
    adversarial_loss: float


@dataclass(frozen=True)
class ScoredObject:
    """Results of scoring one candidate.

    results: by the detector's name, the attacked one first. measurement: rendering and constraints. milliseconds: by
    stage; the attacked detector's is "detector", another's "scored_by_<name>".
    """

    results: dict[str, DetectorResult]
    measurement: Measurement
    milliseconds: dict[str, float]


class NoisyCopyScorer:
    """Warm start for scoring the noisy copies of a solution.

    The copies start from the solution's rendering (`note`) and from the detector's state for the scene without the
    object. Each copy is the frame after the empty scene, and its rendering the one after the solution's, so that no
    score depends on earlier copies: equal bit for bit. Source: our choice: the paper scores every scene from scratch.
    """

    def __init__(self) -> None:
        self.warm: WarmStart | None = None
        self._seen: dict[BevWindow, IncrementalInference] = {}

    def note(self, method: str, scored: ScoredObject) -> None:
        """Keep the rendering of a scored candidate if it is the solution; the copies start from it."""
        if method == "adversarial":
            self.warm = scored.measurement.rendering.warm

    def frames(self, problem: AttackProblem, theta: Tensor) -> IncrementalInference:
        """Return incremental inference that has seen a pose's scoring window (pose (6,)) without the object."""
        window = problem.detector.window_for((float(theta[0]), float(theta[1])), SCORE_RADIUS_M)
        if window not in self._seen:
            seen = self._seen[window] = incremental_inference(problem.detector, window)
            if not isinstance(seen, UncachedInference):  # WholeWindow keeps no state
                seen.proposals(to_network_frame(problem.cast_beams.points, problem.ground_z_m), window)
        return self._seen[window].fork()


def score_object(
    problem: AttackProblem,
    code: Tensor,
    theta: Tensor,
    radius_m: float,
    others: Mapping[str, Detector] | None = None,
    nearby: NoisyCopyScorer | None = None,
) -> ScoredObject:
    """Render one code (d,) at one pose (6,) once, and score the rendering with every detector.

    radius_m: largest distance of a detecting box's centre from the object's centre, metres. others: further detectors
    by name, for the same rendering. nearby: warm start of the rendering and of the problem's own detector; None: from
    scratch.
    Source: SHIFT3D, Evaluation Metrics.
    """
    with torch.no_grad():
        frames, warm = (None, None) if nearby is None else (nearby.frames(problem, theta), nearby.warm)
        measurement = measure(problem, code, theta, warm, SCORE_RADIUS_M, frames)
        box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
        spent = dict(measurement.milliseconds)
        with timed(spent, "detector"):
            results = {problem.detector.name: _result(measurement.proposals, box, radius_m)}
        for name, detector in (others or {}).items():
            with timed(spent, f"scored_by_{name}"):
                results |= score_points(problem, measurement.rendering.points, theta, radius_m, {name: detector})
    return ScoredObject(results, measurement, spent)


@contextlib.contextmanager
def timed(spent: dict[str, float], stage: str) -> Iterator[None]:
    """Add the milliseconds of a block to a stage."""
    start = time.perf_counter()
    yield
    spent[stage] = spent.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)


def score_points(
    problem: AttackProblem, points: Tensor, theta: Tensor, radius_m: float, detectors: Mapping[str, Detector]
) -> dict[str, DetectorResult]:
    """Score a scene (N, 3) that holds the problem's object at a pose (6,), by the detectors' names."""
    box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
    return score_box(points, box, problem.ground_z_m, radius_m, detectors)


def score_box(
    points: Tensor, box: NDArray[np.float64], ground_z_m: float, radius_m: float, detectors: Mapping[str, Detector]
) -> dict[str, DetectorResult]:
    """Score the object of a box (7,), network frame, in a scene (N, 3), by the detectors' names.

    points: scene frame, metres. radius_m: largest distance of a detecting box's centre from the object's centre,
    metres.
    """
    found = boxes_around(points, box, ground_z_m, detectors)
    return {name: _result(proposals, box, radius_m) for name, proposals in found.items()}


def boxes_around(
    points: Tensor, box: NDArray[np.float64], ground_z_m: float, detectors: Mapping[str, Detector]
) -> dict[str, Proposals]:
    """Return every proposal around a box (7,), network frame, in a scene (N, 3), by the detectors' names."""
    seen, centre = to_network_frame(points, ground_z_m), (float(box[0]), float(box[1]))
    with torch.no_grad():
        return {
            name: detector.proposals(seen, detector.window_for(centre, SCORE_RADIUS_M))
            for name, detector in detectors.items()
        }


def detections_near(proposals: Proposals, box: NDArray[np.float64], radius_m: float) -> Detections:
    """Return the detections around a box (7,) after suppression, best first, down to the one that gives the score.

    radius_m: largest distance of that detection's centre from the object's centre, metres.
    """
    return detections_until(proposals, box, is_near(proposals.boxes.double().numpy(), box, radius_m))


def detections_until(proposals: Proposals, box: NDArray[np.float64], wanted: NDArray[np.bool_]) -> Detections:
    """Return the detections around a box (7,) after suppression, best first, down to the first one `wanted` (A,).

    The result depends neither on boxes farther away nor on the number of proposals: a detector that sees the whole
    scene returns tens of thousands that reach SCORE_FLOOR.
    """
    around = is_near(proposals.boxes.double().numpy(), box, _AROUND_M)
    return suppress(proposals, SCORE_FLOOR, SUPPRESSION_IOU, torch.from_numpy(around), wanted)


def _result(proposals: Proposals, box: NDArray[np.float64], radius_m: float) -> DetectorResult:
    detections = detections_near(proposals, box, radius_m)
    return DetectorResult(detection_score(detections, box, radius_m), float(adversarial_loss(proposals, box)))
