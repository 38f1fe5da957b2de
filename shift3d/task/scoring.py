"""What detectors make of one object: score and loss of each, and whether it may stand there."""

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
from shift3d.detectors.incremental.inference import IncrementalInference, WholeWindow, incremental_inference
from shift3d.detectors.nms import suppress
from shift3d.render.solvers.search import WarmStart
from shift3d.vehicles.vehicle import Vehicle

# Scores below this count as 0: their boxes are not even candidates for suppression. Recall curves are drawn
# over [0, 1], so that the detector's own cut-off for display (0.1) would put a step into them. Our choice.
SCORE_FLOOR = 0.01
# Of suppression. Source: the public Waymo config.
SUPPRESSION_IOU = 0.25
# Boxes centred farther away suppress none near the object, nor any that could. It holds the corners of every window.
_AROUND_M = 2.0 * SCORE_RADIUS_M
# Methods of many candidates that differ little from the solution, in one place: see `Nearby`.
SCORED_NEARBY = ("adversarial_noise",)


@dataclass(frozen=True)
class Candidate:
    """One object to be scored: a code and a pose, and how they were come by.

    vehicle: whose frame the code is drawn in; None: the task's own.
    """

    method: str
    replicate: int
    code: Tensor
    theta: Tensor
    best_step: int | None = None
    status: str = "ok"
    vehicle: Vehicle | None = None

    def is_same_object(self, other: Candidate) -> bool:
        """Whether code, pose and frame are another's, to the bit."""
        same = torch.equal(self.code, other.code) and torch.equal(self.theta, other.theta)
        return same and self.vehicle is other.vehicle


@dataclass(frozen=True)
class Answer:
    """What one detector makes of an object.

    score: of the best box after suppression within the detection radius, 0 if none. adversarial_loss: L_adv.
    """

    score: float
    adversarial_loss: float


@dataclass(frozen=True)
class Scored:
    """What a candidate came to.

    answers: by the detector's name, the attacked one first. measurement: its rendering and constraints.
    milliseconds: by stage; the attacked detector's is "detector", another's "scored_by_<name>".
    """

    answers: dict[str, Answer]
    measurement: Measurement
    milliseconds: dict[str, float]


class Nearby:
    """Where the scores of noisy copies of a solution start: at the rendering of the solution (`note`), and at what a
    detector makes of the scene without the object.

    Each of them is the frame after the empty scene, and the rendering after the solution's, so that no answer depends
    on what was asked before, to the bit. Source: our choice: the paper scores every scene afresh.
    """

    def __init__(self) -> None:
        self.warm: WarmStart | None = None
        self._seen: dict[BevWindow, IncrementalInference] = {}

    def note(self, method: str, scored: Scored) -> None:
        """A candidate of a method has been scored: if it is the solution, its copies start from it."""
        if method == "adversarial":
            self.warm = scored.measurement.rendering.warm

    def frames(self, problem: AttackProblem, theta: Tensor) -> IncrementalInference:
        """Incremental inference that has seen the scoring window of a pose (6,) without the object."""
        window = problem.detector.window_for((float(theta[0]), float(theta[1])), SCORE_RADIUS_M)
        if window not in self._seen:
            seen = self._seen[window] = incremental_inference(problem.detector, window)
            if not isinstance(seen, WholeWindow):  # which keeps nothing
                seen.proposals(to_network_frame(problem.cast_beams.points, problem.ground_z_m), window)
        return self._seen[window].fork()


def score_object(
    problem: AttackProblem,
    code: Tensor,
    theta: Tensor,
    radius_m: float,
    others: Mapping[str, Detector] | None = None,
    nearby: Nearby | None = None,
) -> Scored:
    """Render one code (d,) at one pose (6,) afresh, once, and score it with every detector.

    radius_m: how near the object's centre the centre of a detecting box lies, metres. others: detectors by name that
    score the same rendering, beside the problem's own. nearby: of the problem's own detector; rendering and answer
    then start from there.
    Source: SHIFT3D, Evaluation Metrics.
    """
    with torch.no_grad():
        frames, warm = (None, None) if nearby is None else (nearby.frames(problem, theta), nearby.warm)
        measurement = measure(problem, code, theta, warm, SCORE_RADIUS_M, frames)
        box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
        spent = dict(measurement.milliseconds)
        with timed(spent, "detector"):
            answers = {problem.detector.name: _answer(measurement.proposals, box, radius_m)}
        for name, detector in (others or {}).items():
            with timed(spent, f"scored_by_{name}"):
                answers |= score_points(problem, measurement.rendering.points, theta, radius_m, {name: detector})
    return Scored(answers, measurement, spent)


@contextlib.contextmanager
def timed(spent: dict[str, float], stage: str) -> Iterator[None]:
    """Add the milliseconds that a block takes to those of a stage."""
    start = time.perf_counter()
    yield
    spent[stage] = spent.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)


def score_points(
    problem: AttackProblem, points: Tensor, theta: Tensor, radius_m: float, detectors: Mapping[str, Detector]
) -> dict[str, Answer]:
    """What detectors make of a scene (N, 3) that holds the problem's object at a pose (6,), by their names."""
    box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
    return score_box(points, box, problem.ground_z_m, radius_m, detectors)


def score_box(
    points: Tensor, box: NDArray[np.float64], ground_z_m: float, radius_m: float, detectors: Mapping[str, Detector]
) -> dict[str, Answer]:
    """What detectors make of the object of a box (7,), network frame, in a scene (N, 3), by their names.

    points: scene frame, metres. radius_m: how near the object's centre the centre of a detecting box lies, metres.
    """
    found = boxes_around(points, box, ground_z_m, detectors)
    return {name: _answer(proposals, box, radius_m) for name, proposals in found.items()}


def boxes_around(
    points: Tensor, box: NDArray[np.float64], ground_z_m: float, detectors: Mapping[str, Detector]
) -> dict[str, Proposals]:
    """Every proposal around the object of a box (7,), network frame, in a scene (N, 3), by the detectors' names."""
    seen, centre = to_network_frame(points, ground_z_m), (float(box[0]), float(box[1]))
    with torch.no_grad():
        return {
            name: detector.proposals(seen, detector.window_for(centre, SCORE_RADIUS_M))
            for name, detector in detectors.items()
        }


def detections_near(proposals: Proposals, box: NDArray[np.float64], radius_m: float) -> Detections:
    """What suppression leaves, best first, down to the box that gives the object of a box (7,) its score.

    radius_m: how near the object's centre the centre of that box lies, metres.
    """
    return detections_until(proposals, box, is_near(proposals.boxes.double().numpy(), box, radius_m))


def detections_until(proposals: Proposals, box: NDArray[np.float64], wanted: NDArray[np.bool_]) -> Detections:
    """What suppression leaves around a box (7,), best first, down to the first of the proposals wanted (A,).

    It hangs on nothing farther away, nor on how many proposals there are: a detector that sees the whole scene gives
    tens of thousands that reach SCORE_FLOOR.
    """
    around = is_near(proposals.boxes.double().numpy(), box, _AROUND_M)
    return suppress(proposals, SCORE_FLOOR, SUPPRESSION_IOU, torch.from_numpy(around), wanted)


def _answer(proposals: Proposals, box: NDArray[np.float64], radius_m: float) -> Answer:
    detections = detections_near(proposals, box, radius_m)
    return Answer(detection_score(detections, box, radius_m), float(adversarial_loss(proposals, box)))
