"""Average precision in order of scores, counted by hand."""

from __future__ import annotations

import numpy as np
import pytest
from frames_by_hand import cars, frame, shift_for

from shift3d.evaluation.average_precision import FrameMatches, PrecisionRecall, area_r40, greedy_curve, match_frame
from shift3d.evaluation.frames import compare


def _match(
    found: np.ndarray,
    scores: list[float],
    truth: np.ndarray,
    truth_counts: list[bool] | None = None,
    boxes_count: list[bool] | None = None,
) -> FrameMatches:
    return match_frame(
        compare(frame(truth, found, scores), "BEV"),
        np.array([True] * len(truth) if truth_counts is None else truth_counts, dtype=bool),
        np.array([True] * len(found) if boxes_count is None else boxes_count, dtype=bool),
        iou_threshold=0.7,
    )


def _exact(*frames: FrameMatches) -> PrecisionRecall:
    return greedy_curve(frames, at_40_recalls=False)


def test_perfect_detections_give_one() -> None:
    matches = _match(cars(0, 10, 20), [0.9, 0.8, 0.7], cars(20, 0, 10))
    for at_40_recalls in (False, True):
        curve = greedy_curve([matches], at_40_recalls)
        assert curve.average_precision == curve.average_precision_heading == 1.0


def test_counted_by_hand() -> None:
    # By score: hit, miss, hit, miss; four vehicles. Precision 1, 1/2, 2/3, 2/4 at recall 1/4, 1/4, 1/2, 1/2. The
    # envelope is 1 up to recall 1/4, then 2/3 up to 1/2, nothing beyond: 1/4 + 1/4 * 2/3.
    matches = _match(cars(0, 100, 10, 200), [0.9, 0.8, 0.7, 0.6], cars(0, 10, 20, 30))
    curve = _exact(matches)
    assert curve.average_precision == pytest.approx(0.25 + 0.25 * 2 / 3)
    assert curve.recall.tolist() == [0.25, 0.25, 0.5, 0.5]
    assert curve.score_threshold.tolist() == [0.9, 0.8, 0.7, 0.6]
    assert curve.num_truth == 4
    # Ten of the 40 recalls are up to 1/4, ten more up to 1/2.
    assert greedy_curve([matches], at_40_recalls=True).average_precision == pytest.approx((10 + 10 * 2 / 3) / 40)


def test_a_recall_position_that_is_just_reached_counts() -> None:
    # 3 of 40 found, no false detection: positions 1/40, 2/40 and 3/40.
    recall = np.arange(1, 4) / 40
    assert area_r40(recall, np.ones(3)) == pytest.approx(3 / 40)
    assert area_r40(recall - 1e-6, np.ones(3)) == pytest.approx(2 / 40)


def test_frames_are_pooled_by_score() -> None:
    # Miss at 0.8 in one frame before the hit at 0.7 in the other: precision 1/2 at recall 1.
    frames = [_match(cars(50), [0.8], cars()), _match(cars(0), [0.7], cars(0))]
    assert _exact(*frames).average_precision == pytest.approx(0.5)


def test_the_better_score_wins_the_vehicle() -> None:
    # 0.9 overlaps both vehicles enough and takes the one with the larger overlap; 0.8 overlaps that one alone: false.
    a, b = cars(0, 1)
    matches = _match(np.array([cars(0.4)[0], a]), [0.9, 0.8], np.array([a, b]))
    assert matches.is_true.tolist() == [True, False]


def test_a_second_detection_of_the_same_vehicle_is_wrong() -> None:
    assert _match(cars(0, 0.1), [0.9, 0.8], cars(0)).is_true.tolist() == [True, False]


def test_overlap_just_below_and_at_the_threshold() -> None:
    shift = shift_for(0.7)
    assert _match(cars(shift - 1e-6), [0.5], cars(0)).is_true.tolist() == [True]
    assert _match(cars(shift + 1e-6), [0.5], cars(0)).is_true.tolist() == [False]


def test_ignored_vehicles_are_neither_right_nor_wrong() -> None:
    matches = _match(cars(0, 10, 10.1), [0.9, 0.8, 0.7], cars(0, 10), truth_counts=[True, False])
    assert matches.scores.tolist() == [0.9]
    assert matches.num_truth == 1


def test_detections_outside_the_region_are_dropped_unless_they_match() -> None:
    matches = _match(cars(0, 99), [0.9, 0.8], cars(0), boxes_count=[False, False])
    assert matches.is_true.tolist() == [True]


def test_equal_scores_enter_together() -> None:
    # In either order: one hit and one miss at the same score is precision 1/2.
    for is_true in ([True, False], [False, True]):
        flags = np.array(is_true)
        curve = _exact(FrameMatches(np.array([0.5, 0.5]), flags, flags.astype(float), 1))
        assert curve.average_precision == curve.average_precision_heading == pytest.approx(0.5)


def test_headings_weigh_the_precision_alone() -> None:
    # One of two turned by a quarter: accuracy 1/2. Precision with headings 1 at recall 1/2, then 3/4 at recall 1.
    found = np.concatenate((cars(0), cars(10, heading=np.pi)))
    truth = np.concatenate((cars(0), cars(10, heading=np.pi / 2)))
    truth[1, 3:5] = (2.0, 4.0)  # the same footprint, turned
    curve = _exact(_match(found, [0.9, 0.8], truth))
    assert curve.average_precision == 1.0
    assert curve.average_precision_heading == pytest.approx(0.5 * 1.0 + 0.5 * 0.75)


def test_nothing_found_and_nothing_to_find() -> None:
    for at_40_recalls in (False, True):
        missed = greedy_curve([_match(cars(), [], cars(0))], at_40_recalls)
        assert missed.average_precision == missed.average_precision_heading == 0.0
        nothing = greedy_curve([_match(cars(0), [0.9], cars())], at_40_recalls)
        assert nothing.average_precision is None and nothing.average_precision_heading is None
        assert greedy_curve([], at_40_recalls).average_precision is None
