"""Hard cases of the loss: saturated scores, proposals that are NaN, and no proposal at all."""

from __future__ import annotations

import math

import numpy as np
import torch
from catalogue import hard_case

from shift3d.attack.objective import adversarial_loss, detection_score, overlap_weights, proposal_score
from shift3d.detectors.base import Detections, Proposals

AREA = "loss and IoU"
CAR = np.array([20.0, 0.0, 0.8, 4.0, 2.0, 1.6, 0.3])


def proposals(boxes: np.ndarray, *logits: float) -> Proposals:
    """Return proposals with these boxes (A, 7) and float32 logits that carry a gradient."""
    leaf = torch.tensor(logits, dtype=torch.float32, requires_grad=True)
    return Proposals(
        torch.from_numpy(np.asarray(boxes, dtype=np.float32).reshape(-1, 7)), leaf, torch.arange(len(leaf))
    )


def moved(x_m: float) -> np.ndarray:
    """Return the car's box, moved along x."""
    return CAR + np.array([x_m, 0, 0, 0, 0, 0, 0])


@hard_case(
    area=AREA,
    why="1 - p rounds to 0 from a logit of 17 on in float32, and its logarithm is infinite",
    must="the loss is IoU times the logit, and its gradient is the IoU",
    guard="-log(1 - p) is taken as softplus of the logit: 1 - p is never formed",
)
def a_score_that_rounds_to_one() -> None:
    for logit in (17.5, 40.0, 200.0, 3e38):
        found = proposals(CAR, logit)
        weight = float(overlap_weights(found, CAR)[0])
        assert weight > 0.999
        loss = adversarial_loss(found, CAR)
        (gradient,) = torch.autograd.grad(loss, found.logits)
        assert math.isclose(float(loss.detach()), weight * logit, rel_tol=1e-6)
        assert math.isclose(float(gradient[0]), weight, rel_tol=1e-6)


@hard_case(
    area=AREA,
    why="1 - p rounds to 1 below a logit of -17 in float32, and its logarithm to 0",
    must="the loss keeps its value exp(l) and its gradient; both are 0 and not NaN where exp(l) underflows",
    guard="softplus of the logit instead of the logarithm of 1 - p",
)
def a_score_next_to_zero() -> None:
    for logit in (-18.0, -30.0, -80.0, -1e4):
        found = proposals(CAR, logit)
        weight = float(overlap_weights(found, CAR)[0])
        loss = adversarial_loss(found, CAR)
        (gradient,) = torch.autograd.grad(loss, found.logits)
        for value in (float(loss.detach()), float(gradient[0])):
            assert math.isclose(value, weight * math.exp(logit), rel_tol=1e-5)


@hard_case(
    area=AREA,
    why="0 times infinity is NaN: one overflowed logit anywhere in the window would spoil the whole loss",
    must="a proposal that does not overlap the object adds nothing, whatever its logit",
    guard="only the rows with a positive IoU enter the sum",
)
def an_infinite_logit_far_from_the_object() -> None:
    near = proposals(CAR, 1.0)
    both = proposals(np.stack((CAR, moved(9.0), moved(-7.0))), 1.0, math.inf, math.nan)
    loss = adversarial_loss(both, CAR)
    (gradient,) = torch.autograd.grad(loss, both.logits)
    assert float(loss.detach()) == float(adversarial_loss(near, CAR).detach())
    assert gradient.tolist() == [gradient[0].item(), 0.0, 0.0] and gradient[0] > 0.7


@hard_case(
    area=AREA,
    why="a maximum over nothing has no value",
    must="loss and scores are exactly 0, and the loss still has a gradient: zero",
    guard="the score of an object without a proposal in reach is 0",
)
def no_proposal_at_all() -> None:
    for found in (proposals(np.zeros((0, 7))), proposals(moved(30.0), 4.0)):
        loss = adversarial_loss(found, CAR)
        (gradient,) = torch.autograd.grad(loss, found.logits)
        assert float(loss.detach()) == 0.0 and not gradient.any()
        assert proposal_score(found, CAR) == 0.0
    assert detection_score(Detections(np.zeros((0, 7)), np.zeros(0)), CAR) == 0.0


@hard_case(
    area=AREA,
    why="a box exactly 5 m from the object either detects it or leaves a blind spot",
    must="it does not detect it: nearer than 5 m is required",
    guard="the strict comparison in the score",
)
def a_box_exactly_at_the_detection_radius() -> None:
    at = CAR + np.array([3.0, -4.0, 0, 0, 0, 0, 0])  # 3, 4, 5: exact in floating point
    nearer = np.array([*np.nextafter(at[:2], CAR[:2]), *at[2:]])
    assert detection_score(Detections(at[None], np.array([0.9])), CAR) == 0.0
    assert detection_score(Detections(np.stack((at, nearer)), np.array([0.9, 0.4])), CAR) == 0.4
