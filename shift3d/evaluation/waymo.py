"""Average precision by Waymo's definition: score cut-offs, best assignment at each, area under what results.

Source: the public metrics library of the Waymo Open Dataset (detection_metrics.cc, matcher.cc, metrics_utils.cc and
the settings of compute_detection_metrics_main.cc). It was read, not copied; tests/reference holds the answers of the
compiled library to crowded frames, and ours agree at every cut-off. What differs: IoU enters the assignment exactly
and not rounded to a thousandth, range is horizontal, and without an object to find there is no value (there: 0).
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
LARGEST_GAP = 0.05  # of recall, between neighbouring points of the curve
# LEVEL_1 is more than five points, LEVEL_2 at least one. No label of ours says that an object is hard.
LEVELS = {"LEVEL_1": 6, "LEVEL_2": 1}


@dataclass(frozen=True)
class Assignment:
    """A frame's detections within a range and what each is assigned to, at every score cut-off.

    comparison: the frame, cut to the range. num_found: (101,) int64, detections that reach each cut-off (they come
    best first). matched: num_found -> (num_found,) int64, index of the object each is assigned to, or -1.
    """

    comparison: Comparison
    num_found: Ints
    matched: dict[int, Ints]


def assign(comparison: Comparison, iou_threshold: float, min_range_m: float, max_range_m: float) -> Assignment:
    """Assign detections to objects so that the sum of their IoU is largest, separately at every score cut-off.

    Only pairs with IoU >= iou_threshold may be assigned. Objects without a point do not exist; detections and
    objects at min_range_m <= range < max_range_m take part, each by its own centre.
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
    if conflict_free:  # the best assignment of fewer detections is then a part of that of all
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
    """What became of one frame's detections and objects at the 101 score cut-offs, and how many objects to find.

    level: "LEVEL_1" or "LEVEL_2". credit_harder: what becomes of a detection that is assigned to an object of
    LEVEL_2 while LEVEL_1 is evaluated. True: it is right, as in Waymo's library (whose recall is then right ones
    over right ones plus missed LEVEL_1 objects). False: it is neither right nor wrong.
    among: (M,) bool, the objects that are asked for; a detection of another one is neither right nor wrong. None: all.
    share: (K,) float64 in [0, 1], how much each detection counts where it is wrong. None: 1.
    Returns: (4, 101) float64: right detections, wrong ones, missed objects, and the heading accuracies of the right
        ones. Of several frames both are summed.
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
    """The curve over all frames; arguments as of `cutoff_counts`."""
    counts = [cutoff_counts(assignment, level, credit_harder) for assignment in assignments]
    table = sum((own for own, _ in counts), start=np.zeros((4, len(SCORE_CUTOFFS))))
    return curve_of(table, sum(number for _, number in counts))


def curve_of(table: Floats, num_truth: float) -> PrecisionRecall:
    """Precision and recall at the 101 cut-offs of `cutoff_counts`, and the areas AP and APH.

    APH: each right detection enters the precision with its heading accuracy; recall is not weighted. Where recall is
    0, precision is 1. AP and APH are None without an object to find.
    """
    right, wrong, missed, heading = table
    tiny = np.finfo(np.float64).tiny  # right ones may be a fraction where frames are weighted
    recall = right / np.maximum(right + missed, tiny)
    precision = np.where(right == 0, 1.0, right / np.maximum(right + wrong, tiny))
    heading_precision = np.where(right == 0, 1.0, heading / np.maximum(right + wrong, tiny))
    return PrecisionRecall(
        area_with_gaps(recall, precision) if num_truth else None,
        area_with_gaps(recall, heading_precision) if num_truth else None,
        SCORE_CUTOFFS,
        recall,
        precision,
        heading_precision,
        int(num_truth),
    )


def _count(
    assignment: Assignment, number: int, eligible: Flags, rewarded: Flags, share: Floats
) -> tuple[int, float, int, float]:
    """Right, wrong, missed, and the sum of the heading accuracies of the right ones."""
    matched = assignment.matched[number]
    rows = np.flatnonzero(matched >= 0)
    rows = rows[rewarded[matched[rows]]]
    false = (matched < 0) & assignment.comparison.found.labelled[:number]
    unmatched = np.ones(len(eligible), dtype=bool)
    unmatched[matched[matched >= 0]] = False
    # Sums in a fixed order, whatever the number of frames a worker had.
    heading = float(sum(assignment.comparison.heading_accuracy[rows, matched[rows]].tolist()))
    return len(rows), float(sum(share[:number][false].tolist())), int((eligible & unmatched).sum()), heading


def area_with_gaps(recall: Sequence[float] | Floats, precision: Sequence[float] | Floats) -> float:
    """Area under a precision-recall curve as Waymo's library takes it.

    Of points with equal recall the highest precision stays; precision at a recall is the highest there or beyond;
    trapezoids between points. Where neighbouring points are further apart than LARGEST_GAP, points every
    LARGEST_GAP below the higher recall take its precision, so that a steep line is drawn over one gap at most.
    At recall 0, the precision is that of the point before it.
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
    if len(points) > 1:  # the point at recall 0 was put there, not measured
        points[-1] = (points[-1][0], points[-2][1])
    return float(sum(0.5 * (r1 - r0) * (p1 + p0) for (r1, p1), (r0, p0) in pairwise(points)))
