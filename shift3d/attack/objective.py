"""Adversarial loss, and scores of a detector's proposals and detections."""

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

A box from an anchor farther away would need a displacement of more than 3 m to touch a car at the centre. Our choice:
the paper does not say where proposals end.
"""

SCORE_RADIUS_M = 12.0
"""Radius of the detector's window for scoring.

The window holds every box whose centre is within 5 m, and every box that can suppress such a box (it overlaps, so its
centre is nearer than 5 m plus one box diagonal). A box beyond 12 m that suppresses a suppressor is missing. Our choice:
the paper scores the whole scene.
"""


def to_network_frame(points: Tensor, ground_z_m: float) -> Tensor:
    """Measure z of scene points (N, 3) from the ground, as detectors expect it. Differentiable."""
    return points - points.new_tensor([0.0, 0.0, ground_z_m])


def object_box(theta: Tensor, size_m: np.ndarray | tuple[float, float, float], ground_z_m: float) -> np.ndarray:
    """Return the ground-truth box y* (7,) of the inserted object, network frame, float64.

    Centre and heading follow the pose (a seven-number box has no pitch and roll); the size is the baseline vehicle's.
    Source: SHIFT3D, Adversarial Loss Functions (y* moves with the pose).
    """
    x, y, z, yaw = (float(value) for value in theta.detach()[:4])
    return np.array([x, y, z - ground_z_m, *(float(edge) for edge in size_m), yaw])


def overlap_weights(proposals: Proposals, box: np.ndarray) -> Tensor:
    """Compute (A,) rotated bird's-eye-view IoU of every proposal with y* (7,), detached, dtype of the logits.

    Source: SHIFT3D eq. adv_loss; "2D boxes in bird's eye view".
    """
    weights = iou_bev(proposals.boxes.detach().double().numpy(), box[None])[:, 0]
    return torch.as_tensor(weights, dtype=proposals.logits.dtype)


def adversarial_loss(proposals: Proposals, box: np.ndarray) -> Tensor:
    """Compute L_adv = sum over the proposals that overlap y* of -IoU(y*, y_i) log(1 - p_i).

    -log(1 - p) with p = sigmoid(l) is softplus(l): 1 - p is never formed, so a saturated score gives a finite loss.
    Only logits carry gradients. Without an overlapping proposal the loss is exactly 0.

    Returns a scalar, dtype of the logits. Differentiable w.r.t. what the logits depend on.
    Source: SHIFT3D eq. adv_loss.
    """
    weights = overlap_weights(proposals, box)
    rows = torch.nonzero(weights > 0).squeeze(1)
    return (weights[rows] * torch.nn.functional.softplus(proposals.logits[rows])).sum()


def latent_penalty(code: Tensor, baseline_code: Tensor) -> Tensor:
    """Compute ||z - z0||^2, which lambda weights. Source: SHIFT3D eq. loss_z."""
    return (code - baseline_code).square().sum()


def latent_distance(code: Tensor, baseline_code: Tensor) -> float:
    """Compute ||z - z0|| in float64 in a fixed order of summation: the same bytes with every build of torch."""
    offset = code.detach().double().numpy() - baseline_code.detach().double().numpy()
    try:
        return math.sqrt(math.fsum(float(value) ** 2 for value in offset))
    except OverflowError:  # a square overflows float64 in a search that diverges
        return math.hypot(*offset.tolist())


def detection_score(detections: Detections, box: np.ndarray, radius_m: float = DETECTION_RADIUS_M) -> float:
    """Return the highest score of a box (after suppression) whose centre is within radius_m of the object's; 0 if none.

    The distance is taken in the ground plane. Source: SHIFT3D, Evaluation Metrics.
    """
    near = is_near(detections.boxes, box, radius_m)
    return float(detections.scores[near].max()) if near.any() else 0.0


def is_near(boxes: np.ndarray, box: np.ndarray, radius_m: float) -> np.ndarray:
    """Return (N,) bool: centre of boxes (N, 7) within radius_m of the centre of a box (7,), in the ground plane."""
    return np.asarray(np.hypot(*(boxes[:, :2] - box[:2]).T) < radius_m)


def proposal_score(proposals: Proposals, box: np.ndarray) -> float:
    """Return the highest score of a proposal near the object before suppression, which a trace gets at no cost."""
    near = is_near(proposals.boxes.detach().double().numpy(), box, DETECTION_RADIUS_M)
    return float(torch.sigmoid(proposals.logits.detach()[torch.from_numpy(near)].max())) if near.any() else 0.0


def window_around(detector: Detector, theta: Tensor, radius_m: float | None) -> BevWindow | None:
    """Return the detector's exact window around an object at pose theta (6,); None (whole scene) for radius_m None."""
    if radius_m is None:
        return None
    x, y = (float(value) for value in theta.detach()[:2])
    return detector.window_for((x, y), radius_m)
