"""Average precision with greedy matching by score, and with ignored objects and detections."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from shift3d.evaluation.frames import Comparison, Flags, Floats


@dataclass(frozen=True)
class PrecisionRecall:
    """Precision-recall curve over all frames as the score threshold varies.

    average_precision: AP in [0, 1]; average_precision_heading: APH, at most AP. Both are None without an object to
    find. score_threshold, recall, precision, heading_precision: (K,) float64, one row per point of the curve;
    heading_precision weights each true positive by its heading accuracy. num_truth: number of objects to find.
    """

    average_precision: float | None
    average_precision_heading: float | None
    score_threshold: Floats
    recall: Floats
    precision: Floats
    heading_precision: Floats
    num_truth: int


@dataclass(frozen=True)
class FrameMatches:
    """True and false positives of one frame, without the ignored detections.

    scores: (K,) float64; is_true: (K,) bool, True for true positives; heading_accuracy: (K,) float64, 0 for false
    positives; num_truth: number of vehicles that count.
    """

    scores: Floats
    is_true: Flags
    heading_accuracy: Floats
    num_truth: int


def match_frame(comparison: Comparison, truth_counts: Flags, boxes_count: Flags, iou_threshold: float) -> FrameMatches:
    """Match each detection, highest score first, to the unmatched vehicle with the largest overlap.

    truth_counts: (M,), False for ignored vehicles (too far, too few points): a detection that matches only ignored
    vehicles is neither a true nor a false positive, and several detections may match the same ignored vehicle.
    boxes_count: (K,), in the order of ``comparison.found``, False for detections outside the evaluated region: they are
    dropped unless they match a vehicle that counts. A match needs IoU >= iou_threshold.

    Source: KITTI's rules for ignored objects; greedy by score as in VOC and nuScenes (our choice: KITTI's development
    kit loops over objects, which differs only if several detections overlap one object by more than the threshold).
    """
    scores = np.asarray(comparison.found.scores, dtype=np.float64)
    free, is_true, is_false = truth_counts.copy(), *np.zeros((2, len(scores)), dtype=bool)
    accuracy = np.zeros(len(scores))
    for index, overlap in enumerate(comparison.overlap):
        enough = overlap >= iou_threshold
        candidates = np.flatnonzero(enough & free)
        if candidates.size:
            best = candidates[np.argmax(overlap[candidates])]
            free[best], is_true[index] = False, True
            accuracy[index] = comparison.heading_accuracy[index, best]
        else:
            is_false[index] = boxes_count[index] and not (enough & ~truth_counts).any()
    kept = is_true | is_false
    return FrameMatches(scores[kept], is_true[kept], accuracy[kept], int(truth_counts.sum()))


def area_exact(recall: Floats, precision: Floats) -> float:
    """Compute the exact area under interpolated precision (best at equal or higher recall). Source: VOC from 2010."""
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(recall, prepend=0.0) * envelope))


def area_r40(recall: Floats, precision: Floats) -> float:
    """Compute the mean interpolated precision at the recalls 1/40, 2/40, ..., 1; 0 at recalls that are not reached.

    Source: KITTI's 40 recall positions (since 2019). This function follows the definition. KITTI's development kit
    instead uses the 41 score thresholds closest to these recalls: for ten objects that are all found first it gives
    9/40, the definition gives 1.
    """
    envelope = np.append(np.maximum.accumulate(precision[::-1])[::-1], 0.0)
    # The tolerance makes a floating-point recall of 3/40 reach the position 3/40.
    first = np.searchsorted(recall, np.arange(1, 41) / 40.0 - 1e-9)
    return float(np.mean(envelope[first]))


def greedy_curve(frames: Iterable[FrameMatches], at_40_recalls: bool) -> PrecisionRecall:
    """Compute the curve over all frames with AP and APH: at KITTI's 40 recalls, or as the exact area.

    Detections with equal scores form one point of the curve. The precision for APH weights each true positive by its
    heading accuracy; KITTI and VOC have no APH (our choice, after Waymo's).
    """
    matches = list(frames)
    num_truth = sum(frame.num_truth for frame in matches)
    scores = np.concatenate([np.empty(0), *(frame.scores for frame in matches)])
    is_true = np.concatenate([np.empty(0, dtype=bool), *(frame.is_true for frame in matches)])
    accuracy = np.concatenate([np.empty(0), *(frame.heading_accuracy for frame in matches)])
    order = np.lexsort((accuracy, is_true, -scores))
    scores = scores[order]
    last_of_tie = np.append(np.diff(scores) != 0, True)[: scores.size]
    right = np.cumsum(is_true[order])[last_of_tie].astype(np.float64)
    headings = np.cumsum(accuracy[order])[last_of_tie]
    answers = (np.arange(scores.size) + 1.0)[last_of_tie]
    recall, precision, heading_precision = right / max(num_truth, 1), right / answers, headings / answers
    area = area_r40 if at_40_recalls else area_exact
    return PrecisionRecall(
        area(recall, precision) if num_truth else None,
        area(recall, heading_precision) if num_truth else None,
        scores[last_of_tie],
        recall,
        precision,
        heading_precision,
        num_truth,
    )
