"""Every metric of a detector, from the same stored detections: Waymo's, KITTI's and the project's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shift3d.evaluation.average_precision import PrecisionRecall, greedy_curve, match_frame
from shift3d.evaluation.frames import VIEWS, Comparison, DetectedFrame, View, compare
from shift3d.evaluation.waymo import LEVELS, assign, waymo_curve

IOU_THRESHOLDS = (0.7, 0.5)
# Waymo's own bins are the last three; a sensor's labels end at 75 m.
RANGES_M = ((0.0, 75.0), (0.0, 50.0), (0.0, 30.0), (30.0, 50.0), (50.0, 75.0))
# What an object may have at most in the image, by KITTI's definition: it is applied where labels are read.
KITTI_DIFFICULTIES = ("easy", "moderate", "hard")
# Detections lower than this in the image do not count: KITTI asks nobody to find objects that small.
_LEAST_HEIGHT_PX = (40.0, 25.0, 25.0)
OWN_SUBSET, OWN_POINTS, OWN_RANGE_M = "20 points", 20, (0.0, 50.0)


@dataclass(frozen=True)
class Metric:
    """A curve with its areas, and what it is a curve of.

    protocol: "waymo", as Waymo's library counts; "waymo_strict", the same but for detections of LEVEL_2 objects, which
    are left out of LEVEL_1; "kitti", 40 recall positions; "shift3d", exact area. view: "BEV" or "3D". subset: which
    objects count: LEVEL_1, LEVEL_2; easy, moderate, hard; "20 points", at least so many. min_range_m <= distance
    < max_range_m, horizontal; None: no limit.
    """

    protocol: str
    view: View
    subset: str
    iou_threshold: float
    min_range_m: float | None
    max_range_m: float | None
    curve: PrecisionRecall


def evaluate(frames: Sequence[DetectedFrame]) -> Iterator[Metric]:
    """Every metric of the frames, in a fixed order.

    Waymo's for both levels, all ranges; KITTI's by its difficulties where there is a camera, else by Waymo's levels;
    the project's own. Each in both views, at both IoU thresholds. A metric without an object to find has no value.
    """
    graded = any(
        (frame.truth.difficulty >= 0).any() or np.isfinite(frame.found.image_height_px).any() for frame in frames
    )
    for view in VIEWS:
        comparisons = [compare(frame, view) for frame in frames]
        for iou_threshold in IOU_THRESHOLDS:
            yield from _waymo(comparisons, view, iou_threshold)
            yield from _kitti(comparisons, view, iou_threshold, graded)
            curve = _by_points(comparisons, iou_threshold, OWN_POINTS, OWN_RANGE_M, at_40_recalls=False)
            yield Metric("shift3d", view, OWN_SUBSET, iou_threshold, *OWN_RANGE_M, curve)


def _waymo(comparisons: Sequence[Comparison], view: View, iou_threshold: float) -> Iterator[Metric]:
    for range_m in RANGES_M:
        assignments = [assign(comparison, iou_threshold, *range_m) for comparison in comparisons]
        for level in LEVELS:
            curve = waymo_curve(assignments, level)
            yield Metric("waymo", view, level, iou_threshold, *range_m, curve)
        strict = waymo_curve(assignments, "LEVEL_1", credit_harder=False)
        yield Metric("waymo_strict", view, "LEVEL_1", iou_threshold, *range_m, strict)


def _kitti(comparisons: Sequence[Comparison], view: View, iou_threshold: float, graded: bool) -> Iterator[Metric]:
    if graded:
        for grade, name in enumerate(KITTI_DIFFICULTIES):
            curve = kitti_curve(comparisons, iou_threshold, grade)
            yield Metric("kitti", view, name, iou_threshold, None, None, curve)
        return
    for level, points in LEVELS.items():
        for range_m in RANGES_M[:2]:
            curve = _by_points(comparisons, iou_threshold, points, range_m, at_40_recalls=True)
            yield Metric("kitti", view, level, iou_threshold, *range_m, curve)


def kitti_curve(comparisons: Sequence[Comparison], iou_threshold: float, difficulty: int) -> PrecisionRecall:
    """KITTI's curve for difficulty 0 (easy), 1 or 2 (hard): objects up to it count, harder ones are ignored.

    Detections outside the labelled camera view, or too low in the image for the difficulty, are no errors. KITTI's
    DontCare areas have no box and so, as in its development kit, no effect in either view.
    """
    matches = []
    for comparison in comparisons:
        truth, found = comparison.truth, comparison.found
        boxes_count = found.labelled & ~(found.image_height_px < _LEAST_HEIGHT_PX[difficulty])
        truth_counts = truth.counts & (truth.difficulty <= difficulty)
        matches.append(match_frame(comparison, truth_counts, boxes_count, iou_threshold))
    return greedy_curve(matches, at_40_recalls=True)


def _by_points(
    comparisons: Sequence[Comparison],
    iou_threshold: float,
    min_points: int,
    range_m: tuple[float, float],
    at_40_recalls: bool,
) -> PrecisionRecall:
    """Objects with enough points within the range count, others are ignored; detections beyond it are no errors."""
    matches = []
    for comparison in comparisons:
        truth, found = comparison.truth, comparison.found
        within = (truth.range_m >= range_m[0]) & (truth.range_m < range_m[1])
        boxes_count = found.labelled & (found.range_m >= range_m[0]) & (found.range_m < range_m[1])
        truth_counts = np.asarray(truth.counts & (truth.num_points >= min_points) & within, dtype=bool)
        matches.append(match_frame(comparison, truth_counts, boxes_count, iou_threshold))
    return greedy_curve(matches, at_40_recalls)
