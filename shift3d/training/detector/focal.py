"""Focal losses on logits: finite for any finite logit, because 1 - p is never formed."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

FOCAL_ALPHA = 0.25
FOCAL_GAMMA = 2.0
HEAT_BETA = 4.0


def focal_loss(logits: Tensor, is_positive: Tensor) -> Tensor:
    """Focal loss of each anchor, same shape. Differentiable w.r.t. logits.

    Source: Lin et al. 2017, alpha 0.25, gamma 2.
    """
    target = is_positive.to(logits.dtype)
    cross_entropy = functional.softplus(logits) - logits * target
    wrong = torch.sigmoid(torch.where(is_positive, -logits, logits))  # 1 - p_t
    alpha = torch.where(is_positive, FOCAL_ALPHA, 1.0 - FOCAL_ALPHA)
    return alpha * wrong**FOCAL_GAMMA * cross_entropy


def heat_map_loss(logits: Tensor, heat: Tensor) -> Tensor:
    """Loss of each cell against its heat in [0, 1], same shape; 1 is a centre, and near one a score costs less.

    Differentiable w.r.t. logits. Source: CornerNet (Law and Deng 2018), equation 1, as in CenterPoint.
    """
    wrong = torch.sigmoid(torch.where(heat == 1.0, -logits, logits))
    cross_entropy = functional.softplus(torch.where(heat == 1.0, -logits, logits))
    return (1.0 - heat).pow(HEAT_BETA).masked_fill(heat == 1.0, 1.0) * wrong**FOCAL_GAMMA * cross_entropy
