"""Breakdown of detector metrics by range, heading, number of points and kind of vehicle, with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shift3d.evaluation.frames import VIEWS, DetectedFrame, Flags, Floats, Ints, compare
from shift3d.evaluation.groups import Group, aspect, groups_of
from shift3d.evaluation.intervals import DRAWS, frame_weights, interval, weighted_median
from shift3d.evaluation.vehicles import ERRORS, VehicleRows, vehicle_rows
from shift3d.evaluation.waymo import LEVELS, SCORE_CUTOFFS, Assignment, assign, curve_of, cutoff_counts

Statistic = Callable[[Floats, Floats], float | None]
"""Function of errors and the weights of their frames, e.g. a weighted mean."""

IOU = 0.7


@dataclass(frozen=True)
class BreakdownRow:
    """Value of one measure for one group, with its 95 % interval over resampled frames and the number of vehicles.

    measure: AP, APH (Waymo's, LEVEL_1, IoU 0.7), recall, flips, or error_ and a name of ERRORS. statistic: the view for
    AP and APH; view and IoU for recall; median, mean or std for errors. value: None without a vehicle. low, high: None
    if these vehicles occur in fewer than two frames.
    """

    by: str
    group: str
    measure: str
    statistic: str
    value: float | None
    low: float | None
    high: float | None
    number: int


@dataclass(frozen=True)
class AveragePrecisionDraws:
    """AP or APH of `number` vehicles. drawn: values over resampled frames; empty if fewer than two have vehicles."""

    value: float | None
    drawn: Sequence[float | None]
    number: int


def overall_areas(frames: Sequence[DetectedFrame]) -> dict[tuple[str, str], AveragePrecisionDraws]:
    """Compute AP and APH over all vehicles by (measure, view), as in `breakdown`.

    The resampled frames do not depend on the detections, so that values of two detectors are paired.
    """
    weights = frame_weights(len(frames))
    found: dict[tuple[str, str], AveragePrecisionDraws] = {}
    everything = Group("all", "all")
    for view in VIEWS:
        assigned = [assign(compare(frame, view), IOU, *everything.range_m) for frame in frames]
        areas = _group_areas(everything, assigned, weights)
        found |= {(measure, view): area for measure, area in areas.items()}
    return found


def breakdown(frames: Sequence[DetectedFrame], draws: int = DRAWS) -> tuple[VehicleRows, list[BreakdownRow]]:
    """Return every vehicle that counts, and the rows of every group in a fixed order.

    AP of a group ignores vehicles of other groups. A false positive belongs to the range and heading of its box. It has
    no number of points and no kind: in groups by these, each false positive is weighted by the group's share of all
    vehicles (our choice). Recall, flips and errors cover vehicles of LEVEL_1, see `vehicles`.
    """
    vehicles = vehicle_rows(frames)
    weights = frame_weights(len(frames), draws)
    assigned: dict[tuple[str, float, float], list[Assignment]] = {}
    rows: list[BreakdownRow] = []
    for group in groups_of(vehicles.kind):
        for view in VIEWS:
            key = (view, *group.range_m)
            if key not in assigned:
                assigned[key] = [assign(compare(frame, view), IOU, *key[1:]) for frame in frames]
            for measure, area in _group_areas(group, assigned[key], weights).items():
                low, high = interval(area.drawn)
                rows.append(BreakdownRow(group.by, group.name, measure, view, area.value, low, high, area.number))
        rows += _of_vehicles(group, vehicles, len(frames), weights)
    return vehicles, rows


def _group_areas(group: Group, assignments: Sequence[Assignment], weights: Floats) -> dict[str, AveragePrecisionDraws]:
    truths = [assignment.comparison.truth for assignment in assignments]
    inside = [group.members(truth.boxes, truth.num_points, truth.kinds) for truth in truths]
    eligible = [truth.counts & (truth.num_points >= LEVELS["LEVEL_1"]) for truth in truths]
    total = sum(int(flags.sum()) for flags in eligible)
    share = sum(int((one & two).sum()) for one, two in zip(inside, eligible)) / max(1, total)
    counts = []
    for assignment, among in zip(assignments, inside, strict=True):
        found = assignment.comparison.found
        wrong = np.ones(len(found.scores))
        if group.by == "heading":
            wrong = np.array([own == group.name for own in aspect(found.boxes)], dtype=np.float64)
        elif group.by in ("points", "body", "attribute"):
            wrong = np.full(len(found.scores), share)
        counts.append(cutoff_counts(assignment, "LEVEL_1", among=among, share=wrong))
    stacked = np.array([table for table, _ in counts]).reshape(-1, 4, len(SCORE_CUTOFFS))
    numbers = np.array([float(number) for _, number in counts])

    def areas(drawn: Floats) -> tuple[float | None, float | None]:
        curve = curve_of(np.tensordot(drawn, stacked, 1), float(drawn @ numbers))
        return curve.average_precision, curve.average_precision_heading

    values, number = areas(np.ones(len(counts))), int(numbers.sum())
    # If all vehicles are in one frame, every draw gives the same value.
    drawn = list(zip(*map(areas, weights))) if np.count_nonzero(numbers) > 1 else [(), ()]
    return {name: AveragePrecisionDraws(value, own, number) for name, value, own in zip(("AP", "APH"), values, drawn)}


def _of_vehicles(group: Group, rows: VehicleRows, num_frames: int, weights: Floats) -> Iterator[BreakdownRow]:
    eligible = group.members(rows.boxes, rows.num_points, rows.kind) & (rows.num_points >= LEVELS["LEVEL_1"])
    low, high = group.range_m
    eligible &= (rows.range_m >= low) & (rows.range_m < high)
    found = eligible & rows.matched

    def row(measure: str, statistic: str, owner: Ints, of: Callable[[Floats], float | None]) -> BreakdownRow:
        """Make a row. owner: (N,) frame of each vehicle."""
        value = of(np.ones(num_frames)) if len(owner) else None
        low, high = interval(map(of, weights) if len(np.unique(owner)) > 1 else ())
        return BreakdownRow(group.by, group.name, measure, statistic, value, low, high, len(owner))

    def share(measure: str, statistic: str, hit: Flags, of: Flags) -> BreakdownRow:
        above = np.bincount(rows.frame[hit & of], minlength=num_frames)
        below = np.bincount(rows.frame[of], minlength=num_frames)

        def fraction(drawn: Floats) -> float | None:
            return float(drawn @ above / (drawn @ below)) if drawn @ below > 0 else None

        return row(measure, statistic, rows.frame[of], fraction)

    def spread(name: str, statistic: str, of_errors: Statistic, errors: Floats, owner: Ints) -> BreakdownRow:
        return row(f"error_{name}", statistic, owner, lambda drawn: of_errors(errors, drawn[owner]))

    for text, overlap in (("BEV 0.7", rows.iou_bev), ("3D 0.7", rows.iou_3d)):
        yield share("recall", text, rows.matched & (overlap >= IOU), eligible)
    yield share("recall", "BEV 0.5", rows.matched, eligible)
    yield share("flips", "share", rows.flipped, found)
    for column, name in enumerate(ERRORS):
        order = np.flatnonzero(found)[np.argsort(rows.errors[found, column], kind="stable")]
        for statistic, of_errors in (("median", weighted_median), ("mean", _mean), ("std", _std)):
            yield spread(name, statistic, of_errors, rows.errors[order, column], rows.frame[order])


def _mean(values: Floats, weights: Floats) -> float | None:
    return float(values @ weights / weights.sum()) if weights.sum() > 0.0 else None


def _std(values: Floats, weights: Floats) -> float | None:
    mean = _mean(values, weights)
    return None if mean is None else float(np.sqrt(((values - mean) ** 2) @ weights / weights.sum()))
