"""Which anchors a vehicle trains, and toward what."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from shift3d.detectors.models.box_coding import direction_bins, encode_boxes

__all__ = ["IGNORED", "NEGATIVE", "POSITIVE", "Targets", "assign_targets", "nearest_bev_iou"]

IGNORED, NEGATIVE, POSITIVE = -1, 0, 1
POSITIVE_IOU = 0.55
NEGATIVE_IOU = 0.40
NEGLIGIBLE_IOU = 0.05


@dataclass(frozen=True)
class Targets:
    """labels (A,) int64 in {-1, 0, 1}; positives (P,) int64, anchors; codes (P, 7); directions (P,) int64."""

    labels: Tensor
    positives: Tensor
    codes: Tensor
    directions: Tensor

    def to(self, device: torch.device) -> Targets:
        """The same targets on a device."""
        parts = (self.labels, self.positives, self.codes, self.directions)
        return Targets(*(part.to(device) for part in parts))


def _axis_aligned(boxes: Tensor) -> Tensor:
    """Boxes snapped to the nearest axis: (N, 4) x0, y0, x1, y1."""
    folded = torch.remainder(boxes[:, 6] + pi / 4, pi)
    along_x = folded < pi / 2
    half_x = torch.where(along_x, boxes[:, 3], boxes[:, 4]) / 2
    half_y = torch.where(along_x, boxes[:, 4], boxes[:, 3]) / 2
    x, y = boxes[:, 0], boxes[:, 1]
    return torch.stack((x - half_x, y - half_y, x + half_x, y + half_y), dim=1)


def nearest_bev_iou(anchors: Tensor, boxes: Tensor) -> Tensor:
    """BEV IoU of boxes snapped to the nearest axis: (A, 7), (M, 7) -> (A, M).

    Source: SECOND's public code ("nearest" IoU): cheap, and enough to decide which anchors to train.
    """
    a, b = _axis_aligned(anchors)[:, None], _axis_aligned(boxes)[None]
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    inner = (high - low).clamp(min=0).prod(dim=-1)
    areas = (a[..., 2:] - a[..., :2]).prod(dim=-1) + (b[..., 2:] - b[..., :2]).prod(dim=-1)
    return inner / (areas - inner)


def assign_targets(anchors: Tensor, boxes: Tensor, usable: Tensor, counts: Tensor) -> Targets:
    """Anchors (A, 7), vehicles (M, 7) -> targets.

    usable: (M,) bool; the others (too few points) only turn the anchors they overlap into ignored ones.
    counts: (A,) bool, anchors that may be trained at all (not in the crop's rim).
    Positive at IoU >= 0.55, and the best anchor of each usable vehicle whatever its IoU; negative below 0.40.
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
    labels[~counts] = IGNORED
    positives = torch.nonzero(labels == POSITIVE).squeeze(1)
    matched = boxes[owner[positives]] if len(boxes) else anchors[positives]
    codes = encode_boxes(matched, anchors[positives])
    return Targets(labels, positives, codes, direction_bins(matched[:, 6]))
