"""Errors, flips, groups and intervals, on frames whose numbers can be counted."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from frames_by_hand import cars, frame

from shift3d.evaluation.breakdown import BreakdownRow, breakdown
from shift3d.evaluation.frames import DetectedFrame
from shift3d.evaluation.groups import aspect, groups_of
from shift3d.evaluation.intervals import frame_weights, interval, weighted_median
from shift3d.evaluation.metrics import evaluate
from shift3d.evaluation.vehicles import ERRORS, vehicle_rows

Rows = dict[tuple[str, str, str, str], BreakdownRow]


def _rows(frames: list[DetectedFrame]) -> Rows:
    return {(row.by, row.group, row.measure, row.statistic): row for row in breakdown(frames, draws=40)[1]}


def _random_frames(count: int = 12) -> list[DetectedFrame]:
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(count):
        truth = cars(*np.arange(8.0, 70.0, 7.0))
        truth[:, 6] = rng.uniform(-pi, pi, len(truth))
        found = truth[rng.random(len(truth)) < 0.8] + rng.normal(0.0, 0.08, 7)
        found = np.concatenate((found, cars(*rng.uniform(10, 60, 3), y=20.0)))
        frames.append(frame(truth, found, rng.uniform(0.05, 1.0, len(found)).tolist(),
                            rng.integers(1, 600, len(truth)).tolist()))  # fmt: skip
    return frames


def test_errors_are_measured_in_the_vehicle_s_own_axes() -> None:
    """A car faces left: a box 0.3 m to the left is ahead of it, and a box 0.1 m behind in x is to its left."""
    truth = cars(20.0, heading=pi / 2)
    found = truth + np.array([[-0.1, 0.3, 0.05, 0.2, -0.1, 0.15, 0.02]])
    rows = vehicle_rows([frame(truth, found, [0.9])])
    assert rows.errors[0] == pytest.approx([0.3, 0.1, 0.05, 0.2, -0.1, 0.15, 0.02])
    assert not rows.flipped[0] and rows.matched[0] and rows.aspect == ("side",)


def test_a_box_turned_round_is_flipped_and_its_axis_is_right() -> None:
    truth = cars(20.0, 30.0, heading=3.0)
    found = truth + np.array([[0, 0, 0, 0, 0, 0, pi - 0.1], [0, 0, 0, 0, 0, 0, 0.1]])
    rows = vehicle_rows([frame(truth, found, [0.9, 0.8])])
    assert rows.flipped.tolist() == [True, False]
    assert rows.errors[:, ERRORS.index("heading_rad")] == pytest.approx([-0.1, 0.1])
    assert _rows([frame(truth, found, [0.9, 0.8])])["all", "all", "flips", "share"].value == 0.5


def test_the_best_detection_matches_once_and_what_does_not_count_is_left_out() -> None:
    truth = cars(20.0, 30.0, 40.0)
    found = np.concatenate((truth[:1], truth[:1] + 0.05, truth[2:]))
    rows = vehicle_rows([frame(truth, found, [0.6, 0.9, 0.1], counts=[True, True, False])])
    assert rows.row.tolist() == [0, 1] and rows.score[0] == 0.9 and np.isnan(rows.score[1])
    assert rows.matched.tolist() == [True, False] and np.isnan(rows.errors[1]).all()
    nothing = vehicle_rows([frame(truth, cars(), [])])
    assert not nothing.matched.any() and nothing.iou_3d.tolist() == [0.0] * 3


@pytest.mark.parametrize(
    ("bearing", "heading", "expected"),
    [(0.0, 0.0, "rear"), (0.0, pi, "front"), (0.0, pi / 2, "side"), (0.0, pi / 4, "oblique"), (2.0, 2.0, "rear"),
     (2.0, 2.0 - pi, "front"), (-2.0, -2.0 - pi / 2, "side")],
)  # fmt: skip
def test_which_side_the_beam_meets(bearing: float, heading: float, expected: str) -> None:
    box = np.array([[30 * np.cos(bearing), 30 * np.sin(bearing), 0, 4, 2, 1.5, heading]])
    assert aspect(box) == (expected,)


def test_over_all_it_is_waymo_s_value() -> None:
    frames = _random_frames()
    rows = _rows(frames)
    for metric in evaluate(frames):
        if metric.protocol != "waymo" or metric.iou_threshold != 0.7 or metric.subset != "LEVEL_1":
            continue
        high = metric.max_range_m
        keys = {75.0: ("all", "all"), 30.0: ("range", "0-30 m")}
        if metric.min_range_m == 0.0 and high in keys:
            row, curve = rows[*keys[high], "AP", metric.view], metric.curve
            # Sums of the same numbers with zeros in between: the last bit depends on the processor.
            assert row.value == pytest.approx(curve.average_precision, rel=1e-14) and row.number == curve.num_truth
            heading = rows[*keys[high], "APH", metric.view].value
            assert heading == pytest.approx(curve.average_precision_heading, rel=1e-14)


def test_a_group_counts_its_own_vehicles_alone() -> None:
    """Two cars seen from behind are found, two from the side are not; a false alarm is turned across the beam."""
    truth = np.concatenate((cars(20.0, 30.0), cars(40.0, 50.0, heading=pi / 2)))
    found = np.concatenate((truth[:2], cars(60.0, heading=pi / 2)))
    rows = _rows([frame(truth, found, [0.9, 0.8, 0.95])])
    assert rows["heading", "rear", "AP", "BEV"].value == pytest.approx(1.0)
    assert rows["heading", "side", "AP", "BEV"].value == pytest.approx(0.0)
    assert rows["heading", "front", "AP", "BEV"].value is None
    assert rows["heading", "rear", "recall", "BEV 0.7"].value == 1.0
    assert rows["heading", "side", "recall", "BEV 0.7"].value == 0.0
    assert [rows["heading", name, "recall", "BEV 0.7"].number for name in ("rear", "side")] == [2, 2]
    assert rows["range", "30-50 m", "recall", "BEV 0.7"].value == 0.5


def test_false_alarms_fall_on_groups_of_points_as_vehicles_do() -> None:
    truth = cars(20.0, 30.0)
    found = np.concatenate((truth, cars(60.0)))
    rows = _rows([frame(truth, found, [0.9, 0.9, 0.9], points=[10, 50])])
    # Each group has half of the vehicles: one true, half a false alarm.
    assert rows["points", "6-19", "AP", "BEV"].value == pytest.approx(1 / 1.5)
    assert rows["points", "20-99", "AP", "BEV"].value == pytest.approx(1 / 1.5)


def test_recall_by_body_and_by_what_it_carries() -> None:
    one = frame(cars(20.0, 30.0, 40.0), cars(20.0, 40.0), [0.9, 0.9])
    kinds = ("sedan", "sedan+roof_box", "suv+roof_box+trailer")
    rows = _rows([replace(one, truth=replace(one.truth, kinds=kinds))])
    recall = {(by, group): row.value for (by, group, measure, text), row in rows.items()
              if measure == "recall" and text == "BEV 0.7"}  # fmt: skip
    assert recall["body", "sedan"] == 0.5 and recall["body", "suv"] == 1.0
    assert recall["attribute", "roof_box"] == 0.5 and recall["attribute", "trailer"] == 1.0
    assert recall["attribute", "none"] == 1.0
    assert not any(group.by in ("body", "attribute") for group in groups_of(()))


def test_intervals_hold_the_value_and_are_the_same_again() -> None:
    frames = _random_frames()
    rows, again = _rows(frames), _rows(frames)
    assert rows == again
    row = rows["all", "all", "AP", "BEV"]
    assert row.low is not None and row.high is not None and row.value is not None
    assert row.low < row.value < row.high
    alike = _rows([frames[0]] * 5)["all", "all", "AP", "BEV"]
    assert alike.low == pytest.approx(alike.value) and alike.high == pytest.approx(alike.value)
    alone = _rows(frames[:1])["all", "all", "AP", "BEV"]
    assert alone.low is None and alone.high is None


def test_vehicles_of_one_frame_have_no_interval_however_many_frames_there_are() -> None:
    """Every draw has the same number of vehicles, that of the one frame: its interval would seem certain."""
    seen, across = frame(cars(20.0), cars(20.0), [0.9]), cars(40.0, 50.0, heading=pi / 2)
    frames = [seen, frame(across, across[:1], [0.8]), seen]
    rows = _rows(frames)
    side = [row for row in rows.values() if (row.by, row.group) == ("heading", "side") and row.value is not None]
    assert {"AP", "APH", "recall", "flips", "error_x_m"} <= {row.measure for row in side}
    assert all(row.low is None and row.high is None for row in side)
    twice = _rows([*frames, frames[1]])
    assert twice["heading", "side", "AP", "BEV"].low is not None
    assert twice["heading", "side", "error_x_m", "mean"].low is not None


def test_resampled_frames_are_as_many_as_there_are() -> None:
    weights = frame_weights(20)
    assert (weights.sum(axis=1) == 20).all() and np.array_equal(weights, frame_weights(20))
    values = np.random.default_rng(1).normal(0.0, 1.0, 400)
    low, high = interval(float(drawn @ values / 400) for drawn in frame_weights(400))
    assert low is not None and high is not None
    # Of a mean of 400 normal draws: 1.96 standard errors to either side.
    assert high - low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.15)


def test_a_weighted_median_is_that_of_repeated_values() -> None:
    assert weighted_median(np.array([1.0, 2.0, 9.0]), np.array([1.0, 1.0, 5.0])) == 9.0
    assert weighted_median(np.array([1.0, 2.0, 9.0]), np.array([1.0, 1.0, 1.0])) == 2.0
    assert weighted_median(np.array([]), np.array([])) is None
