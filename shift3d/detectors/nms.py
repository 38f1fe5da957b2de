"""Greedy non-maximum suppression (NMS) by exact IoU of rotated boxes in bird's-eye view (BEV)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Detector, Proposals
from shift3d.geometry.iou import iou_bev

MAX_BEFORE_NMS, MAX_KEPT = 4096, 500

Array = npt.NDArray[np.float64]


def rotated_nms(
    boxes: Array,
    scores: Array,
    iou_threshold: float,
    max_kept: int = MAX_KEPT,
    until: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[np.int64]:
    """Return the indices of the kept boxes, highest score first; of equal scores the lower index comes first.

    boxes: (N, 7) metres; scores: (N,). A box is dropped if its BEV IoU with a kept box is above iou_threshold. Exact
    overlaps are computed only for boxes whose circumscribed circles meet. until: (N,) bool; suppression stops after it
    has kept the first of these boxes, because later boxes cannot change the ones already kept. Not differentiable.
    Source: the detector's public config; deterministic order is our choice.
    """
    order = np.argsort(-scores, kind="stable")
    ordered = np.asarray(boxes, dtype=np.float64)[order]
    radius = 0.5 * np.hypot(ordered[:, 3], ordered[:, 4])
    alive = np.ones(len(ordered), dtype=bool)
    kept: list[int] = []
    for index in range(len(ordered)):
        if not alive[index]:
            continue
        kept.append(index)
        if len(kept) == max_kept or (until is not None and until[order[index]]):
            break
        rest = index + 1 + np.flatnonzero(alive[index + 1 :])
        distance = np.hypot(*(ordered[rest, :2] - ordered[index, :2]).T)
        near = rest[distance < radius[rest] + radius[index]]
        if near.size:
            overlap = iou_bev(ordered[index : index + 1], ordered[near])[0]
            alive[near[overlap > iou_threshold]] = False
    return order[np.asarray(kept, dtype=np.int64)]


def suppress(
    proposals: Proposals,
    score_threshold: float,
    iou_threshold: float,
    among: Tensor | None = None,
    until: npt.NDArray[np.bool_] | None = None,
) -> Detections:
    """Turn proposals with at least score_threshold into boxes without overlaps, highest score first.

    among: (A,) bool, the reported proposals that may be kept; None: all. until: (A,) bool, see `rotated_nms`. Without
    `until` at most MAX_BEFORE_NMS proposals enter and MAX_KEPT are kept; with `until` there is no limit, so that one of
    its boxes counts no matter how many boxes score higher. Equal scores are sorted by logit, because in float32 every
    logit above 17 has the score 1; equal logits keep the order of the proposals. NaN passes no threshold. Not
    differentiable. Source: the public Waymo config; until and the order of equals are our choice.
    """
    logits = proposals.logits.detach()
    scores = torch.sigmoid(logits).double().numpy()
    wanted = scores >= score_threshold
    for mask in (proposals.reported, among):
        wanted = wanted if mask is None else wanted & mask.numpy()
    candidates = np.flatnonzero(wanted)
    by_logit = np.argsort(-logits.double().numpy()[candidates], kind="stable")
    most, most_kept = (MAX_BEFORE_NMS, MAX_KEPT) if until is None else (len(candidates), len(candidates))
    candidates = candidates[by_logit[:most]]
    boxes = proposals.boxes.detach().double().numpy()[candidates]
    last = None if until is None else until[candidates]
    kept = rotated_nms(boxes, scores[candidates], iou_threshold, most_kept, last)
    return Detections(boxes[kept], scores[candidates][kept])


class NmsDetector(Detector):
    """Detector whose boxes are its proposals after non-maximum suppression."""

    def detect(
        self, points: Tensor, window: BevWindow | None = None, score_threshold: float = 0.1, iou_threshold: float = 0.25
    ) -> Detections:
        """Return the boxes after suppression, highest score first: at most 4096 enter, 500 remain. Not differentiable.

        With a window, only proposals of its core enter suppression.
        Source: the public Waymo config (thresholds 0.1 and 0.25, 4096 and 500).
        """
        with torch.no_grad():
            return suppress(self.proposals(points, window), score_threshold, iou_threshold)
