"""Average precision by Waymo's definition: optimal assignment at each score cut-off, area under the resulting curve.

Source: the public metrics library of the Waymo Open Dataset (detection_metrics.cc, matcher.cc, metrics_utils.cc and
the settings of compute_detection_metrics_main.cc), read but not copied. tests/reference holds results of the compiled
library for crowded frames; this module agrees at every cut-off. Differences: this module assigns by exact IoU instead
of IoU rounded to a thousandth, uses the horizontal range, and gives None without an object to find (the library: 0).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from shift3d.evaluation.average_precision import PrecisionRecall
from shift3d.evaluation.frames import Comparison, Flags, Floats, Ints

SCORE_CUTOFFS: Floats = np.arange(101) / 100.0
LARGEST_GAP = 0.05  # in recall, between adjacent points of the curve
# LEVEL_1: more than five points; LEVEL_2: at least one. Labels in shift3d have no flag for hard objects.
LEVELS = {"LEVEL_1": 6, "LEVEL_2": 1}


@dataclass(frozen=True)
class Assignment:
    """Assignment of a frame's detections within a range to objects, at every score cut-off.

    comparison: the frame, cut to the range. num_found: (101,) int64, number of detections that reach each cut-off; the
    highest scores come first. matched: num_found -> (num_found,) int64, index of the object assigned to each, or -1.
    """

    comparison: Comparison
    num_found: Ints
    matched: dict[int, Ints]


def assign(comparison: Comparison, iou_threshold: float, min_range_m: float, max_range_m: float) -> Assignment:
    """Assign detections to objects with the largest sum of IoU, separately at every score cut-off.

    Only pairs with IoU >= iou_threshold may be assigned. Only objects with points, and only detections and objects with
    their centre at min_range_m <= range < max_range_m take part.
    """
    truth, found = comparison.truth, comparison.found
    objects = (truth.num_points >= 1) & (truth.range_m >= min_range_m) & (truth.range_m < max_range_m)
    boxes = (found.range_m >= min_range_m) & (found.range_m < max_range_m)
    pairs = np.ix_(boxes, objects)
    overlap, heading_accuracy = comparison.overlap[pairs], comparison.heading_accuracy[pairs]
    cut = Comparison(truth.where(objects), found.at(boxes), overlap, heading_accuracy)
    weights = np.where(cut.overlap >= iou_threshold, cut.overlap, 0.0)
    num_found = (cut.found.scores[None, :] >= SCORE_CUTOFFS[:, None]).sum(axis=1)
    possible = weights > 0.0
    conflict_free = bool((possible.sum(axis=0) <= 1).all() and (possible.sum(axis=1) <= 1).all())
    if conflict_free:  # then the optimal assignment of the first detections is a prefix of that of all
        everything = _best_assignment(weights)
        matched = {int(number): everything[:number] for number in np.unique(num_found)}
    else:
        matched = {int(number): _best_assignment(weights[:number]) for number in np.unique(num_found)}
    return Assignment(cut, num_found.astype(np.int64), matched)


def _best_assignment(weights: Floats) -> Ints:
    matched = np.full(len(weights), -1, dtype=np.int64)
    rows, columns = np.flatnonzero((weights > 0).any(axis=1)), np.flatnonzero((weights > 0).any(axis=0))
    if rows.size:
        chosen, objects = linear_sum_assignment(weights[np.ix_(rows, columns)], maximize=True)
        real = weights[rows[chosen], columns[objects]] > 0.0
        matched[rows[chosen[real]]] = columns[objects[real]]
    return matched


def cutoff_counts(
    assignment: Assignment,
    level: str,
    credit_harder: bool = True,
    among: Flags | None = None,
    share: Floats | None = None,
) -> tuple[Floats, int]:
    """Count the detections and objects of one frame at the 101 score cut-offs.

    level: "LEVEL_1" or "LEVEL_2". credit_harder: applies to detections assigned to LEVEL_2 objects when LEVEL_1 is
    evaluated. True: they are true positives, as in Waymo's library (whose recall is then true positives over true
    positives plus missed LEVEL_1 objects). False: they are ignored. among: (M,) bool, objects to evaluate; detections
    of other objects are ignored; None: all. share: (K,) float64 in [0, 1], weight of each detection as a false
    positive; None: 1.
    Returns: (4, 101) float64: true positives, false positives, missed objects, sum of heading accuracies of the true
        positives; and the number of objects to find. Callers sum both over frames.
    """
    truth = assignment.comparison.truth
    among = np.ones(len(truth.counts), dtype=bool) if among is None else among
    eligible = truth.counts & (truth.num_points >= LEVELS[level]) & among
    rewarded = truth.counts & among if credit_harder else eligible
    share = np.ones(len(assignment.comparison.found.scores)) if share is None else share
    counted = {number: _count(assignment, number, eligible, rewarded, share) for number in assignment.matched}
    table = np.array([counted[number] for number in assignment.num_found.tolist()], dtype=np.float64).T
    return table, int(eligible.sum())


def waymo_curve(assignments: Iterable[Assignment], level: str, credit_harder: bool = True) -> PrecisionRecall:
    """Compute the curve over all frames; arguments as in `cutoff_counts`."""
    counts = [cutoff_counts(assignment, level, credit_harder) for assignment in assignments]
    table = sum((own for own, _ in counts), start=np.zeros((4, len(SCORE_CUTOFFS))))
    return curve_of(table, sum(number for _, number in counts))


def curve_of(table: Floats, num_truth: float) -> PrecisionRecall:
    """Compute precision and recall at the 101 cut-offs of `cutoff_counts`, and the areas AP and APH.

    The precision for APH weights true positives by heading accuracy; recall is not weighted. Precision is 1 at recall
    0. AP and APH are None without an object to find.
    """
    right, wrong, missed, heading = table
    tiny = np.finfo(np.float64).tiny  # weighted frames give fractional counts
    recall = right / np.maximum(right + missed, tiny)
    precision = np.where(right == 0, 1.0, right / np.maximum(right + wrong, tiny))
    heading_precision = np.where(right == 0, 1.0, heading / np.maximum(right + wrong, tiny))
    return PrecisionRecall(
        waymo_area(recall, precision) if num_truth else None,
        waymo_area(recall, heading_precision) if num_truth else None,
        SCORE_CUTOFFS,
        recall,
        precision,
        heading_precision,
        int(num_truth),
    )


def _count(
    assignment: Assignment, number: int, eligible: Flags, rewarded: Flags, share: Floats
) -> tuple[int, float, int, float]:
    """Count true positives, false positives (weighted), missed objects; sum the true positives' heading accuracies."""
    matched = assignment.matched[number]
    rows = np.flatnonzero(matched >= 0)
    rows = rows[rewarded[matched[rows]]]
    false = (matched < 0) & assignment.comparison.found.labelled[:number]
    unmatched = np.ones(len(eligible), dtype=bool)
    unmatched[matched[matched >= 0]] = False
    # Sums in a fixed order, independent of the number of frames of a worker.
    heading = float(sum(assignment.comparison.heading_accuracy[rows, matched[rows]].tolist()))
    return len(rows), float(sum(share[:number][false].tolist())), int((eligible & unmatched).sum()), heading


def waymo_area(recall: Sequence[float] | Floats, precision: Sequence[float] | Floats) -> float:
    """Compute the area under a precision-recall curve as Waymo's library does.

    Of points with equal recall, the one with the highest precision remains. Precision is interpolated (the maximum at
    equal or higher recall); trapezoids join the points. If adjacent points are farther apart than LARGEST_GAP, points
    every LARGEST_GAP below the higher recall get its precision, so that a sloped line spans at most one gap. The
    precision at recall 0 is that of the adjacent point.
    """
    best = {0.0: 1.0}
    for r, p in zip(np.asarray(recall, dtype=np.float64).tolist(), np.asarray(precision, dtype=np.float64).tolist()):
        best[r] = max(best.get(r, 0.0), p)
    points: list[tuple[float, float]] = []
    previous, highest = 0.0, 0.0
    for r in sorted(best, reverse=True):
        while previous - r > LARGEST_GAP + 1e-6:
            previous -= LARGEST_GAP
            points.append((previous, highest))
        highest = max(highest, best[r])
        points.append((r, highest))
        previous = r
    if len(points) > 1:  # the point at recall 0 is not a measurement
        points[-1] = (points[-1][0], points[-2][1])
    return float(sum(0.5 * (r1 - r0) * (p1 + p0) for (r1, p1), (r0, p0) in pairwise(points)))
