"""Training objective of anchor heads: assignment of vehicles to anchors, and the losses."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import torch
import torch.nn.functional as functional
from torch import Tensor

from shift3d.detectors.grid import Grid
from shift3d.detectors.models.anchor_heads import AnchorHeads, anchor_boxes, direction_bins, encode_boxes
from shift3d.detectors.models.network import BoxHeads
from shift3d.training.detector.crops import Crop
from shift3d.training.detector.recipe import Recipe

FOCAL_ALPHA, FOCAL_GAMMA = 0.25, 2.0
IGNORED, NEGATIVE, POSITIVE = -1, 0, 1
POSITIVE_IOU = 0.55
NEGATIVE_IOU = 0.40
NEGLIGIBLE_IOU = 0.05


@dataclass(frozen=True)
class AnchorTargets:
    """Labels (A,) int64 in {-1, 0, 1}; positives (P,) int64, anchor indices; codes (P, 7); directions (P,) int64."""

    labels: Tensor
    positives: Tensor
    codes: Tensor
    directions: Tensor


def _axis_aligned(boxes: Tensor) -> Tensor:
    """Snap boxes to the nearest axis. Returns (N, 4): x0, y0, x1, y1."""
    folded = torch.remainder(boxes[:, 6] + pi / 4, pi)
    along_x = folded < pi / 2
    half_x = torch.where(along_x, boxes[:, 3], boxes[:, 4]) / 2
    half_y = torch.where(along_x, boxes[:, 4], boxes[:, 3]) / 2
    x, y = boxes[:, 0], boxes[:, 1]
    return torch.stack((x - half_x, y - half_y, x + half_x, y + half_y), dim=1)


def nearest_bev_iou(anchors: Tensor, boxes: Tensor) -> Tensor:
    """Compute the BEV IoU of anchors (A, 7) and boxes (M, 7), snapped to the nearest axis. Returns (A, M).

    Source: SECOND's public code ("nearest" IoU): cheap, and exact enough to choose the anchors to train.
    """
    a, b = _axis_aligned(anchors)[:, None], _axis_aligned(boxes)[None]
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    inner = (high - low).clamp(min=0).prod(dim=-1)
    areas = (a[..., 2:] - a[..., :2]).prod(dim=-1) + (b[..., 2:] - b[..., :2]).prod(dim=-1)
    return inner / (areas - inner)


def assign_anchors(anchors: Tensor, boxes: Tensor, usable: Tensor) -> AnchorTargets:
    """Compute the targets of anchors (A, 7) from vehicles (M, 7).

    usable: (M,) bool; the other vehicles (too few points) only turn the anchors that they overlap into ignored ones.
    Positive: IoU >= 0.55, or a usable vehicle's best anchor at IoU > 0.05. Negative: IoU < 0.40.
    Source: public Waymo config of PointPillars.
    """
    labels = torch.full((len(anchors),), NEGATIVE)
    owner = torch.zeros(len(anchors), dtype=torch.int64)
    if len(boxes):
        overlap = nearest_bev_iou(anchors, boxes)
        best, owner = overlap.max(dim=1)
        labels[best >= NEGATIVE_IOU] = IGNORED
        labels[(best >= POSITIVE_IOU) & usable[owner]] = POSITIVE
        ceiling = overlap.max(dim=0).values
        forced = (overlap == ceiling) & (ceiling > NEGLIGIBLE_IOU) & usable
        rows, columns = torch.nonzero(forced, as_tuple=True)
        labels[rows] = POSITIVE
        owner[rows] = columns
    positives = torch.nonzero(labels == POSITIVE).squeeze(1)
    matched = boxes[owner[positives]] if len(boxes) else anchors[positives]
    codes = encode_boxes(matched, anchors[positives])
    return AnchorTargets(labels, positives, codes, direction_bins(matched[:, 6]))


def sine_code_difference(codes: Tensor, wanted: Tensor) -> Tensor:
    """Subtract codes (P, 7), headings by the sine of their difference, so that half turns cost nothing.

    Source: SECOND (Yan et al. 2018), section 3.3.
    """
    heading = torch.sin(codes[:, 6:7] - wanted[:, 6:7])
    return torch.cat((codes[:, :6] - wanted[:, :6], heading), dim=1)


def focal_loss(logits: Tensor, is_positive: Tensor) -> Tensor:
    """Compute the focal loss of each anchor, in the shape of `logits`. Differentiable w.r.t. logits.

    Source: Lin et al. 2017, alpha 0.25, gamma 2.
    """
    target = is_positive.to(logits.dtype)
    cross_entropy = functional.softplus(logits) - logits * target
    wrong = torch.sigmoid(torch.where(is_positive, -logits, logits))  # 1 - p_t
    alpha = torch.where(is_positive, FOCAL_ALPHA, 1.0 - FOCAL_ALPHA)
    return alpha * wrong**FOCAL_GAMMA * cross_entropy


class AnchorObjective:
    """Focal loss (class), smooth L1 (box), cross entropy (direction), each over the number of positive anchors.

    Source: public Waymo config of PointPillars; the recipe gives the weights and the knee of the box loss.
    """

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self.weights = torch.tensor(recipe.code_weights)

    def targets(self, heads: BoxHeads, grid: Grid, crop: Crop) -> AnchorTargets:
        """Compute the targets of one crop."""
        assert isinstance(heads, AnchorHeads)
        anchors = anchor_boxes(heads.anchors, grid, crop.window)
        return assign_anchors(anchors, torch.from_numpy(crop.boxes), torch.from_numpy(crop.usable))

    def cells(self, heads: BoxHeads, target: AnchorTargets) -> Tensor:
        """Return the cells (P,) of the positive anchors."""
        return target.positives // heads.per_cell

    def loss(self, logits: Tensor, box_rows: Tensor, target: AnchorTargets) -> dict[str, Tensor]:
        """Compute the weighted loss parts. logits: (A,). box_rows: (P, R), box outputs at the positives' cells."""
        count, per_cell = max(1, target.positives.numel()), box_rows.shape[1] // 9
        trained = target.labels != IGNORED
        classes = focal_loss(logits[trained], target.labels[trained] == POSITIVE).sum()
        own = (target.positives % per_cell).view(-1, 1, 1)
        codes = box_rows[:, : 7 * per_cell].view(-1, per_cell, 7).take_along_dim(own, dim=1)[:, 0]
        directions = box_rows[:, 7 * per_cell :].view(-1, per_cell, 2).take_along_dim(own, dim=1)[:, 0]
        difference = sine_code_difference(codes, target.codes)
        beta = self.recipe.box_beta
        boxes = functional.smooth_l1_loss(difference, torch.zeros_like(difference), reduction="none", beta=beta)
        boxes = (boxes * self.weights.to(boxes.device)).sum()
        turned = functional.cross_entropy(directions, target.directions, reduction="sum")
        parts = {"class": classes, "box": self.recipe.box_weight * boxes}
        parts["direction"] = self.recipe.direction_weight * turned
        return {name: part / count for name, part in parts.items()}
