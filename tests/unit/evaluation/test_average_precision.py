"""Average precision, counted by hand."""

import numpy as np
import pytest

from shift3d.evaluation.average_precision import FrameMatches, average_precision, match_frame


def _boxes(*x_positions: float) -> np.ndarray:
    """Cars 4 m long and 2 m wide in a row along x."""
    return np.array([[x, 0.0, 0.8, 4.0, 2.0, 1.6, 0.0] for x in x_positions]).reshape(-1, 7)


def _match(
    found: np.ndarray,
    scores: list[float],
    truth: np.ndarray,
    truth_counts: list[bool] | None = None,
    boxes_count: list[bool] | None = None,
) -> FrameMatches:
    return match_frame(
        found,
        np.array(scores, dtype=float),
        truth,
        np.array([True] * len(truth) if truth_counts is None else truth_counts, dtype=bool),
        np.array([True] * len(found) if boxes_count is None else boxes_count, dtype=bool),
        iou_threshold=0.7,
    )


def test_perfect_detections_give_one() -> None:
    frame = _match(_boxes(0, 10, 20), [0.9, 0.8, 0.7], _boxes(20, 0, 10))
    assert average_precision([frame]).value == 1.0


def test_counted_by_hand() -> None:
    # By score: hit, miss, hit, miss; four vehicles. Precision 1, 1/2, 2/3, 2/4 at recall 1/4, 1/4, 1/2, 1/2.
    # The envelope is 1 up to recall 1/4, then 2/3 up to 1/2, nothing beyond: 1/4 + 1/4 * 2/3.
    frame = _match(_boxes(0, 100, 10, 200), [0.9, 0.8, 0.7, 0.6], _boxes(0, 10, 20, 30))
    result = average_precision([frame])
    assert result.value == pytest.approx(0.25 + 0.25 * 2 / 3)
    assert result.recall.tolist() == [0.25, 0.25, 0.5, 0.5]
    assert result.num_truth == 4


def test_frames_are_pooled_by_score() -> None:
    # Miss at 0.8 in one frame before the hit at 0.7 in the other: precision 1/2 at recall 1.
    frames = [_match(_boxes(50), [0.8], _boxes()), _match(_boxes(0), [0.7], _boxes(0))]
    assert average_precision(frames).value == pytest.approx(0.5)


def test_a_second_detection_of_the_same_vehicle_is_wrong() -> None:
    frame = _match(_boxes(0, 0.1), [0.9, 0.8], _boxes(0))
    assert frame.is_true.tolist() == [True, False]


def test_overlap_just_below_and_at_the_threshold() -> None:
    # Shifted by s along 4 m, IoU is (4 - s) / (4 + s): 0.7 at s = 4 * 0.3 / 1.7.
    shift = 4 * 0.3 / 1.7
    assert _match(_boxes(shift - 1e-6), [0.5], _boxes(0)).is_true.tolist() == [True]
    assert _match(_boxes(shift + 1e-6), [0.5], _boxes(0)).is_true.tolist() == [False]


def test_ignored_vehicles_are_neither_right_nor_wrong() -> None:
    frame = _match(_boxes(0, 10, 10.1), [0.9, 0.8, 0.7], _boxes(0, 10), truth_counts=[True, False])
    assert frame.scores.tolist() == [0.9]
    assert frame.num_truth == 1


def test_detections_outside_the_region_are_dropped_unless_they_match() -> None:
    frame = _match(_boxes(0, 99), [0.9, 0.8], _boxes(0), boxes_count=[False, False])
    assert frame.is_true.tolist() == [True]


def test_equal_scores_enter_together() -> None:
    # Whichever comes first: one hit and one miss at the same score is precision 1/2.
    for is_true in ([True, False], [False, True]):
        frame = FrameMatches(np.array([0.5, 0.5]), np.array(is_true), 1)
        assert average_precision([frame]).value == pytest.approx(0.5)


def test_nothing_found_and_nothing_to_find() -> None:
    assert average_precision([_match(_boxes(), [], _boxes(0))]).value == 0.0
    assert np.isnan(average_precision([_match(_boxes(0), [0.9], _boxes())]).value)
    assert np.isnan(average_precision([]).value)
