"""What the detector makes of one object: its score, its loss, and whether it may stand there."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.attack.objective import SCORE_RADIUS_M, detection_score, object_box
from shift3d.attack.problem import AttackProblem, Measurement, measure
from shift3d.detectors.nms import suppress

# Scores below this count as 0: their boxes are not even candidates for suppression. Recall curves are drawn
# over [0, 1], so that the detector's own cut-off for display (0.1) would put a step into them. Our choice.
SCORE_FLOOR = 0.01
# Of suppression. Source: the public Waymo config.
SUPPRESSION_IOU = 0.25


@dataclass(frozen=True)
class Candidate:
    """One object to be scored: a code and a pose, and how they were come by."""

    method: str
    replicate: int
    code: Tensor
    theta: Tensor
    best_step: int | None = None
    status: str = "ok"


@dataclass(frozen=True)
class Scored:
    """What a candidate came to.

    score: of the best box after suppression within the detection radius, 0 if none. measurement: its rendering,
    loss and constraints. milliseconds: by stage.
    """

    score: float
    measurement: Measurement
    milliseconds: dict[str, float]


def score_object(problem: AttackProblem, code: Tensor, theta: Tensor, radius_m: float) -> Scored:
    """Render one code (d,) at one pose (6,) afresh (no warm start) and score it.

    radius_m: how near the object's centre the centre of a detecting box lies, metres.
    Source: SHIFT3D, Evaluation Metrics.
    """
    with torch.no_grad():
        measurement = measure(problem, code, theta, radius_m=SCORE_RADIUS_M)
        start = time.perf_counter()
        detections = suppress(measurement.proposals, SCORE_FLOOR, SUPPRESSION_IOU)
        box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)
        score = detection_score(detections, box, radius_m)
    spent = dict(measurement.milliseconds)
    spent["detector"] += 1e3 * (time.perf_counter() - start)
    return Scored(score, measurement, spent)
