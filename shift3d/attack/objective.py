"""What the attack lowers, and what a detector's answer is worth."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Detector, Proposals
from shift3d.geometry.iou import iou_bev

DETECTION_RADIUS_M = 5.0
"""A box detects the object if its centre is nearer than this. Source: SHIFT3D, Evaluation Metrics."""

ATTACK_RADIUS_M = 8.0
"""Radius of the detector's window for the loss: anchors this near the object's centre are proposals of the loss.

A box from an anchor farther off would have to be displaced by more than 3 m to touch a car at the centre. Our choice:
the paper is silent on where proposals end.
"""

SCORE_RADIUS_M = 12.0
"""Radius of the detector's window for scoring.

It holds every box whose centre lies within 5 m, and every box that can suppress one of these (a suppressing box
overlaps, so its centre is nearer than 5 m plus one box diagonal). Not held: a box beyond 12 m that suppresses a
suppressor. Our choice: the paper scores the whole scene.
"""


def to_network_frame(points: Tensor, ground_z_m: float) -> Tensor:
    """Scene points (N, 3) with z measured from the ground, as detectors take them. Differentiable."""
    return points - points.new_tensor([0.0, 0.0, ground_z_m])


def object_box(theta: Tensor, size_m: np.ndarray | tuple[float, float, float], ground_z_m: float) -> np.ndarray:
    """Ground-truth box y* (7,) of the inserted object, network frame, float64.

    Centre and heading follow the pose (pitch and roll have no place in a seven-number box); the size is the
    baseline vehicle's. Source: SHIFT3D, Adversarial Loss Functions (y* moves with the pose).
    """
    x, y, z, yaw = (float(value) for value in theta.detach()[:4])
    return np.array([x, y, z - ground_z_m, *(float(edge) for edge in size_m), yaw])


def overlap_weights(proposals: Proposals, box: np.ndarray) -> Tensor:
    """(A,) rotated bird's-eye-view IoU of every proposal with y* (7,), detached, dtype of the logits.

    Source: SHIFT3D eq. adv_loss; "2D boxes in bird's eye view".
    """
    weights = iou_bev(proposals.boxes.detach().double().numpy(), box[None])[:, 0]
    return torch.as_tensor(weights, dtype=proposals.logits.dtype)


def adversarial_loss(proposals: Proposals, box: np.ndarray) -> Tensor:
    """L_adv = sum over the proposals that overlap y* of -IoU(y*, y_i) log(1 - p_i).

    -log(1 - p) with p = sigmoid(l) is softplus(l): 1 - p is never formed, so a saturated score gives a
    finite loss. Only logits carry gradients. No overlapping proposal: exactly 0.

    Returns a scalar, dtype of the logits. Differentiable w.r.t. what the logits depend on.
    Source: SHIFT3D eq. adv_loss.
    """
    weights = overlap_weights(proposals, box)
    rows = torch.nonzero(weights > 0).squeeze(1)
    return (weights[rows] * torch.nn.functional.softplus(proposals.logits[rows])).sum()


def latent_penalty(code: Tensor, baseline_code: Tensor) -> Tensor:
    """||z - z0||^2, to be weighed by lambda. Source: SHIFT3D eq. loss_z."""
    return (code - baseline_code).square().sum()


def latent_distance(code: Tensor, baseline_code: Tensor) -> float:
    """||z - z0||, summed in float64 and in a fixed order: the same bytes whatever the build of torch does."""
    offset = code.detach().double().numpy() - baseline_code.detach().double().numpy()
    try:
        return math.sqrt(math.fsum(float(value) ** 2 for value in offset))
    except OverflowError:  # squares beyond float64, on the way to a divergence
        return math.hypot(*offset.tolist())


def detection_score(detections: Detections, box: np.ndarray, radius_m: float = DETECTION_RADIUS_M) -> float:
    """Highest score of a box (after suppression) whose centre is within radius_m of the object's; 0 if none.

    The distance is taken in the ground plane. Source: SHIFT3D, Evaluation Metrics.
    """
    near = is_near(detections.boxes, box, radius_m)
    return float(detections.scores[near].max()) if near.any() else 0.0


def is_near(boxes: np.ndarray, box: np.ndarray, radius_m: float) -> np.ndarray:
    """(N,) bool: which boxes (N, 7) have their centre within radius_m of that of a box (7,), in the ground plane."""
    return np.asarray(np.hypot(*(boxes[:, :2] - box[:2]).T) < radius_m)


def proposal_score(proposals: Proposals, box: np.ndarray) -> float:
    """Highest score of a proposal near the object before suppression: what a trace shows at no cost."""
    near = is_near(proposals.boxes.detach().double().numpy(), box, DETECTION_RADIUS_M)
    return float(torch.sigmoid(proposals.logits.detach()[torch.from_numpy(near)].max())) if near.any() else 0.0


def window_around(detector: Detector, theta: Tensor, radius_m: float | None) -> BevWindow | None:
    """The detector's exact window around an object at pose theta (6,); None (the whole scene) for radius_m None."""
    if radius_m is None:
        return None
    x, y = (float(value) for value in theta.detach()[:2])
    return detector.window_for((x, y), radius_m)
