"""Losses of an anchor detector: focal (class), smooth L1 (box), cross entropy (direction)."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

from shift3d.detectors.models.anchor_heads import AnchorOutputs
from shift3d.training.detector.targets import IGNORED, POSITIVE, Targets

__all__ = ["detection_loss", "focal_loss", "sine_code_difference"]

FOCAL_ALPHA = 0.25
FOCAL_GAMMA = 2.0
BOX_WEIGHT = 2.0
DIRECTION_WEIGHT = 0.2
SMOOTH_L1_BETA = 1.0 / 9.0


def focal_loss(logits: Tensor, is_positive: Tensor) -> Tensor:
    """Focal loss of each anchor, same shape. Finite for any finite logit: 1 - p is never formed.

    Differentiable w.r.t. logits. Source: Lin et al. 2017, alpha 0.25, gamma 2.
    """
    target = is_positive.to(logits.dtype)
    cross_entropy = functional.softplus(logits) - logits * target
    wrong = torch.sigmoid(torch.where(is_positive, -logits, logits))  # 1 - p_t
    alpha = torch.where(is_positive, FOCAL_ALPHA, 1.0 - FOCAL_ALPHA)
    return alpha * wrong**FOCAL_GAMMA * cross_entropy


def sine_code_difference(codes: Tensor, wanted: Tensor) -> Tensor:
    """Difference of (P, 7) codes, the heading's by its sine, so that half turns cost nothing.

    Source: SECOND (Yan et al. 2018), section 3.3.
    """
    heading = torch.sin(codes[:, 6:7] - wanted[:, 6:7])
    return torch.cat((codes[:, :6] - wanted[:, :6], heading), dim=1)


def detection_loss(
    outputs: AnchorOutputs, targets: list[Targets], direction_weight: float = DIRECTION_WEIGHT
) -> tuple[Tensor, dict[str, float]]:
    """Mean over the batch of class + 2 box + direction_weight * direction, each over the number of positive anchors.

    Returns the loss and its parts. Source: public Waymo config of PointPillars.
    """
    total = outputs.logits.new_zeros(())
    parts = {"class": 0.0, "box": 0.0, "direction": 0.0, "positives": 0.0}
    for index, target in enumerate(targets):
        count = max(1, target.positives.numel())
        trained = target.labels != IGNORED
        class_loss = focal_loss(outputs.logits[index][trained], target.labels[trained] == POSITIVE).sum() / count
        difference = sine_code_difference(outputs.codes[index][target.positives], target.codes)
        box_loss = functional.smooth_l1_loss(
            difference, torch.zeros_like(difference), reduction="sum", beta=SMOOTH_L1_BETA
        )
        direction_loss = functional.cross_entropy(
            outputs.directions[index][target.positives], target.directions, reduction="sum"
        )
        total = total + class_loss + (BOX_WEIGHT * box_loss + direction_weight * direction_loss) / count
        parts["class"] += float(class_loss.detach()) / len(targets)
        parts["box"] += float(box_loss.detach()) / count / len(targets)
        parts["direction"] += float(direction_loss.detach()) / count / len(targets)
        parts["positives"] += target.positives.numel() / len(targets)
    return total / len(targets), parts
