"""Metrics of Waymo, KITTI and shift3d from the same stored detections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shift3d.evaluation.average_precision import PrecisionRecall, greedy_curve, match_frame
from shift3d.evaluation.frames import VIEWS, Comparison, DetectedFrame, View, compare
from shift3d.evaluation.waymo import LEVELS, assign, waymo_curve

IOU_THRESHOLDS = (0.7, 0.5)
# The last three are Waymo's bins; labels end at 75 m.
RANGES_M = ((0.0, 75.0), (0.0, 50.0), (0.0, 30.0), (30.0, 50.0), (50.0, 75.0))
# KITTI's difficulties by limits in the image; the label reader applies the limits.
KITTI_DIFFICULTIES = ("easy", "moderate", "hard")
# Detections with a smaller height in the image are ignored, because KITTI does not evaluate objects that small.
_LEAST_HEIGHT_PX = (40.0, 25.0, 25.0)
OWN_SUBSET, OWN_POINTS, OWN_RANGE_M = "20 points", 20, (0.0, 50.0)


@dataclass(frozen=True)
class Metric:
    """Precision-recall curve with its areas, and its settings.

    protocol: "waymo", as Waymo's library counts; "waymo_strict", the same, but LEVEL_1 ignores detections of LEVEL_2
    objects; "kitti", 40 recall positions; "shift3d", exact area. view: "BEV" or "3D". subset: objects that count:
    LEVEL_1, LEVEL_2; easy, moderate, hard; "20 points", at least 20 points. min_range_m <= horizontal distance <
    max_range_m; None: no limit.
    """

    protocol: str
    view: View
    subset: str
    iou_threshold: float
    min_range_m: float | None
    max_range_m: float | None
    curve: PrecisionRecall


def evaluate(frames: Sequence[DetectedFrame]) -> Iterator[Metric]:
    """Yield every metric of the frames in a fixed order, in both views and at both IoU thresholds.

    Waymo's metrics for both levels and all ranges; KITTI's by its difficulties if there is a camera, else by Waymo's
    levels; the metric of shift3d. Metrics without an object to find have the value None.
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
    """Compute KITTI's curve for difficulty 0 (easy), 1 or 2 (hard); harder objects are ignored.

    Detections outside the labelled camera view, or with too small a height in the image, are no errors. KITTI's
    DontCare areas have no 3D box, so they have no effect in either view, as in its development kit.
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
    """Compute the curve for objects with enough points in range; other objects and detections are ignored."""
    matches = []
    for comparison in comparisons:
        truth, found = comparison.truth, comparison.found
        within = (truth.range_m >= range_m[0]) & (truth.range_m < range_m[1])
        boxes_count = found.labelled & (found.range_m >= range_m[0]) & (found.range_m < range_m[1])
        truth_counts = np.asarray(truth.counts & (truth.num_points >= min_points) & within, dtype=bool)
        matches.append(match_frame(comparison, truth_counts, boxes_count, iou_threshold))
    return greedy_curve(matches, at_40_recalls)
