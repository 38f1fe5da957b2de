"""Average precision of vehicle boxes in bird's-eye view, with objects and detections that do not count."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shift3d.geometry.iou import iou_bev

__all__ = ["AveragePrecision", "FrameMatches", "average_precision", "match_frame"]

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class FrameMatches:
    """What became of one frame's detections; those that do not count are left out.

    scores: (K,) float64; is_true: (K,) bool, true positive or not; num_truth: vehicles that count.
    """

    scores: Floats
    is_true: Flags
    num_truth: int


@dataclass(frozen=True)
class AveragePrecision:
    """value in [0, 1] (NaN without any vehicle that counts); recall and precision: (K,), best score first."""

    value: float
    recall: Floats
    precision: Floats
    num_truth: int


def match_frame(
    boxes: Floats,
    scores: Floats,
    truth: Floats,
    truth_counts: Flags,
    boxes_count: Flags,
    iou_threshold: float,
) -> FrameMatches:
    """Match detections, best score first, each to the free vehicle it overlaps most.

    boxes: (K, 7), scores: (K,), truth: (M, 7), one frame, metres. truth_counts: (M,), false for vehicles
    that are ignored (too far, too few points): a detection that matches only such a one is neither right nor
    wrong, and several may match the same one. boxes_count: (K,), false for detections outside the evaluated
    region: they are dropped unless they match a vehicle that counts. A match needs BEV IoU >= iou_threshold.

    Source: KITTI's rules for ignored objects; greedy order as in KITTI and VOC.
    """
    overlap = iou_bev(boxes, truth) if len(boxes) and len(truth) else np.zeros((len(boxes), len(truth)))
    free = truth_counts.copy()
    kept_scores: list[float] = []
    is_true: list[bool] = []
    for index in np.argsort(-scores, kind="stable"):
        enough = overlap[index] >= iou_threshold
        candidates = np.flatnonzero(enough & free)
        if candidates.size:
            free[candidates[np.argmax(overlap[index, candidates])]] = False
            kept_scores.append(float(scores[index]))
            is_true.append(True)
        elif boxes_count[index] and not (enough & ~truth_counts).any():
            kept_scores.append(float(scores[index]))
            is_true.append(False)
    return FrameMatches(np.asarray(kept_scores), np.asarray(is_true, dtype=bool), int(truth_counts.sum()))


def average_precision(frames: Iterable[FrameMatches]) -> AveragePrecision:
    """Area under the precision-recall curve over all frames.

    Interpolation: at every recall, the highest precision at that recall or beyond, integrated over all recall
    steps (VOC 2010 and later; no sampling at fixed recalls). Equal scores enter together.
    """
    matches = list(frames)
    num_truth = sum(frame.num_truth for frame in matches)
    scores = np.concatenate([np.empty(0), *(frame.scores for frame in matches)])
    is_true = np.concatenate([np.empty(0, dtype=bool), *(frame.is_true for frame in matches)])
    order = np.argsort(-scores, kind="stable")
    scores, is_true = scores[order], is_true[order]
    last_of_tie = np.append(np.diff(scores) != 0, True)[: scores.size]
    true_positives = np.cumsum(is_true)[last_of_tie].astype(np.float64)
    answers = (np.arange(scores.size) + 1.0)[last_of_tie]
    if num_truth == 0:
        return AveragePrecision(float("nan"), np.empty(0), np.empty(0), 0)
    recall = true_positives / num_truth
    precision = true_positives / answers
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    value = float(np.sum(np.diff(recall, prepend=0.0) * envelope))
    return AveragePrecision(value, recall, precision, num_truth)
