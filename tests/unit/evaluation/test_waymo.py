"""Waymo's average precision, counted by hand, and changes that must not affect it."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from frames_by_hand import cars, frame, shift_for

from shift3d.evaluation.average_precision import PrecisionRecall
from shift3d.evaluation.frames import DetectedFrame, compare
from shift3d.evaluation.waymo import SCORE_CUTOFFS, assign, waymo_area, waymo_curve


def _curve(
    *frames: DetectedFrame,
    level: str = "LEVEL_1",
    credit_harder: bool = True,
    iou_threshold: float = 0.7,
    view: Literal["BEV", "3D"] = "BEV",
    range_m: tuple[float, float] = (0.0, 75.0),
) -> PrecisionRecall:
    assignments = [assign(compare(item, view), iou_threshold, *range_m) for item in frames]
    return waymo_curve(assignments, level, credit_harder)


def _at(curve: PrecisionRecall, cutoff: float) -> tuple[float, float, float]:
    """Return recall, precision and precision with headings at a score cut-off."""
    row = round(100 * cutoff)
    return float(curve.recall[row]), float(curve.precision[row]), float(curve.heading_precision[row])


def test_cutoffs() -> None:
    assert len(SCORE_CUTOFFS) == 101 and SCORE_CUTOFFS[0] == 0.0 and SCORE_CUTOFFS[-1] == 1.0
    # A detection counts at a cut-off that equals its score.
    curve = _curve(frame(cars(0), cars(0), [0.29]))
    assert _at(curve, 0.29) == (1.0, 1.0, 1.0) and _at(curve, 0.30) == (0.0, 1.0, 1.0)


def test_area_of_hand_drawn_curves() -> None:
    # A single point: its precision holds down to recall 0, beyond it the area is zero.
    assert waymo_area([0.04], [0.5]) == pytest.approx(0.04 * 0.5)
    # Neighbours nearer than 0.05: trapezoids. 0.02 at 0.8, then a slope from 0.8 to 0.6 over 0.04.
    assert waymo_area([0.02, 0.06], [0.8, 0.6]) == pytest.approx(0.02 * 0.8 + 0.04 * 0.7)
    # There is no point from 0.2 to 1: the lower precision holds down to 0.25, one slope is left, then 0.2 at 0.1.
    wide = 0.05 * 0.75 + 0.05 * (0.05 + 0.1) / 2 + 0.2 * 0.1
    assert waymo_area([0.2, 1.0], [0.1, 0.05]) == pytest.approx(wide)
    # A local minimum is lifted to the precision beyond it; the order of points does not matter.
    assert waymo_area([1.0, 0.4, 0.2], [0.05, 0.0, 0.1]) == pytest.approx(wide)
    # At equal recall the higher precision stays.
    assert waymo_area([0.04, 0.04], [0.2, 0.5]) == pytest.approx(0.04 * 0.5)
    assert waymo_area([], []) == 0.0
    assert waymo_area([0.0], [1.0]) == 0.0


def test_three_vehicles_and_four_detections_by_hand() -> None:
    # 0.95 true, 0.85 false, 0.75 true, 0.65 a second detection of the first vehicle: false. One vehicle is missed.
    curve = _curve(frame(cars(0, 10, 20), cars(0, 40, 10, 0.1), [0.95, 0.85, 0.75, 0.65]))
    assert curve.num_truth == 3
    assert _at(curve, 0.96) == (0.0, 1.0, 1.0)
    assert _at(curve, 0.90) == pytest.approx((1 / 3, 1.0, 1.0))
    assert _at(curve, 0.80) == pytest.approx((1 / 3, 1 / 2, 1 / 2))
    assert _at(curve, 0.70) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
    assert _at(curve, 0.00) == pytest.approx((2 / 3, 1 / 2, 1 / 2))
    # 2/3 holds from recall 2/3 down to 2/3 - 6 * 0.05, a slope leads to 1 at 1/3, and 1 holds down to 0.
    edge = 2 / 3 - 6 * 0.05
    expected = (2 / 3 - edge) * 2 / 3 + (edge - 1 / 3) * (2 / 3 + 1) / 2 + 1 / 3
    assert curve.average_precision == pytest.approx(expected)
    assert curve.average_precision_heading == curve.average_precision


def test_the_assignment_is_the_best_and_not_the_greedy_one() -> None:
    # Vehicles A and B; the better detection overlaps A by 0.82 and B by 0.74, the other one A alone, by 0.90. Greedy by
    # score: A goes to the first, the second is false, B is missed. Best sum: both are true.
    a = cars(0)
    first = cars(shift_for(0.82))
    b = cars(float(first[0, 0]) + shift_for(0.74))
    second = cars(-shift_for(0.90))
    made = frame(np.concatenate((a, b)), np.concatenate((first, second)), [0.95, 0.55])
    overlap = compare(made, "BEV").overlap
    np.testing.assert_allclose(overlap[:, 0], [0.82, 0.90], atol=1e-9)
    assert overlap[0, 1] == pytest.approx(0.74) and overlap[1, 1] < 0.7
    curve = _curve(made)
    assert _at(curve, 0.9) == (0.5, 1.0, 1.0)
    assert _at(curve, 0.5) == (1.0, 1.0, 1.0)
    assert curve.average_precision == pytest.approx(1.0)
    # Above 0.55 the better detection takes A, below it B: every cut-off has its own assignment.
    assignment = assign(compare(made, "BEV"), 0.7, 0.0, 75.0)
    assert {number: matched.tolist() for number, matched in assignment.matched.items()} == {0: [], 1: [0], 2: [1, 0]}


def test_levels_differ_by_points() -> None:
    # 6 points: LEVEL_1. 5 and 1: LEVEL_2. 0: no vehicle, and its detection is false.
    truth = cars(0, 10, 20, 30)
    nothing = frame(truth, cars(), [], points=[6, 5, 1, 0])
    assert _curve(nothing, level="LEVEL_1").num_truth == 1
    assert _curve(nothing, level="LEVEL_2").num_truth == 3
    found = frame(truth, cars(0, 30), [0.9, 0.9], points=[6, 5, 1, 0])
    assert _at(_curve(found, level="LEVEL_1"), 0.5) == (1.0, 0.5, 0.5)
    assert _at(_curve(found, level="LEVEL_2"), 0.5) == pytest.approx((1 / 3, 0.5, 0.5))


def test_a_detection_of_a_level_2_object_in_level_1() -> None:
    # One LEVEL_1 vehicle found, one missed, one LEVEL_2 vehicle found, one false detection.
    made = frame(cars(0, 10, 20), cars(0, 20, 40), [0.9, 0.9, 0.9], points=[50, 50, 3])
    # Waymo's library: 2 true, 1 false, 1 missed.
    assert _at(_curve(made), 0.5) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
    # Strictly: 1 true, 1 false, 1 missed; the detection of the LEVEL_2 object is left out.
    assert _at(_curve(made, credit_harder=False), 0.5) == pytest.approx((1 / 2, 1 / 2, 1 / 2))
    # In LEVEL_2 both countings agree.
    both = [_curve(made, level="LEVEL_2", credit_harder=credit) for credit in (True, False)]
    assert both[0].average_precision == both[1].average_precision
    assert _at(both[0], 0.5) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
    # A missed LEVEL_2 vehicle does not lower LEVEL_1.
    missed = frame(cars(0, 20), cars(0), [0.9], points=[50, 3])
    assert _curve(missed).average_precision == pytest.approx(1.0)
    assert _curve(missed, level="LEVEL_2").average_precision == pytest.approx(0.5)


def test_vehicles_that_need_not_be_found_are_neither_right_nor_wrong() -> None:
    made = frame(cars(0, 10), cars(0, 10), [0.9, 0.9], counts=[True, False])
    assert _curve(made).num_truth == 1 and _at(_curve(made), 0.5) == (1.0, 1.0, 1.0)
    missed = frame(cars(0, 10), cars(0), [0.9], counts=[True, False])
    assert _curve(missed).average_precision == pytest.approx(1.0)


def test_detections_where_nothing_is_labelled_are_no_errors() -> None:
    made = frame(cars(0), cars(0, 40), [0.5, 0.9], labelled=[False, False])
    assert _at(_curve(made), 0.2) == (1.0, 1.0, 1.0)


def test_heading_accuracy() -> None:
    truth = cars(0)
    for turn, accuracy in ((np.pi, 0.0), (-np.pi, 0.0), (0.0, 1.0), (2 * np.pi, 1.0), (np.pi - 0.5, 0.5 / np.pi)):
        found = cars(0, heading=turn)
        curve = _curve(frame(truth, found, [0.9]), iou_threshold=0.5)
        assert curve.average_precision == pytest.approx(1.0)
        assert curve.average_precision_heading == pytest.approx(accuracy, abs=1e-12)
    # Headings across the seam at +-pi are near each other.
    near = _curve(frame(cars(0, heading=np.pi - 0.05), cars(0, heading=-np.pi + 0.05), [0.9]), iou_threshold=0.5)
    assert near.average_precision_heading == pytest.approx(1 - 0.1 / np.pi)


def test_exact_headings_give_the_same_with_and_without_them() -> None:
    curve = _curve(_random_frame(3, heading_noise=0.0))
    assert 0.0 < curve.average_precision < 1.0
    assert curve.average_precision_heading == pytest.approx(curve.average_precision, abs=1e-12)


def test_height_counts_in_3d_alone() -> None:
    # Lifted by a fifth of the height: IoU in 3D is (1 - 0.2) / (1 + 0.2) = 2/3.
    made = frame(cars(0), cars(0, z=0.8 + 0.2 * 1.6), [0.9])
    assert _curve(made, view="BEV").average_precision == pytest.approx(1.0)
    assert _curve(made, view="3D").average_precision == 0.0
    assert _curve(made, view="3D", iou_threshold=0.66).average_precision == pytest.approx(1.0)


def test_range_bins_take_objects_and_detections_by_their_own_distance() -> None:
    # A vehicle at 29.9 m with its detection at 30.1 m: missed in the near bin, an error in the next one.
    made = frame(cars(29.9, 40), cars(30.1, 40), [0.9, 0.9])
    near, far = _curve(made, range_m=(0.0, 30.0)), _curve(made, range_m=(30.0, 50.0))
    assert (near.num_truth, near.average_precision) == (1, 0.0)
    assert far.num_truth == 1 and _at(far, 0.5) == (1.0, 0.5, 0.5)
    assert _curve(made).average_precision == pytest.approx(1.0)
    assert _curve(frame(cars(75.0), cars(75.0), [0.9])).num_truth == 0


def test_nothing_found_and_nothing_to_find() -> None:
    missed = _curve(frame(cars(0), cars(), []))
    assert missed.average_precision == missed.average_precision_heading == 0.0
    for nothing in (_curve(frame(cars(), cars(0), [0.9])), _curve(frame(cars(), cars(), [])), _curve()):
        assert nothing.average_precision is None and nothing.average_precision_heading is None
        assert np.isfinite(nothing.precision).all() and np.isfinite(nothing.recall).all()
    # Only LEVEL_2 objects: LEVEL_1 has no value for any detections.
    assert _curve(frame(cars(0), cars(0), [0.9], points=[2])).average_precision is None


def _random_frame(seed: int, heading_noise: float = 0.3) -> DetectedFrame:
    """Return a crowded frame: cars every 1.5 to 5 m, so that detections compete; scores with many ties."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(1.5, 5.0, 14)) - 20.0
    truth = np.concatenate([cars(value, heading=rng.uniform(-0.05, 0.05), y=5.0) for value in x])
    rows = rng.integers(0, len(truth), 24)
    found = truth[rows] + rng.normal(0, 1, (24, 7)) * np.array([0.3, 0.1, 0.1, 0.1, 0.05, 0.05, heading_noise])
    points = rng.integers(0, 12, len(truth))
    return frame(truth, found, np.round(rng.uniform(0, 1, 24), 1).tolist(), points=points.tolist())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("view", ["BEV", "3D"])
def test_the_order_of_detections_changes_no_bit(seed: int, view: Literal["BEV", "3D"]) -> None:
    made = _random_frame(seed)
    order = np.random.default_rng(99).permutation(len(made.found.scores))
    found = type(made.found)(
        made.found.boxes[order], made.found.scores[order], made.found.labelled[order], made.found.image_height_px[order]
    )
    shuffled = DetectedFrame(made.scene, made.truth, found)
    a, b = _curve(made, view=view, iou_threshold=0.5), _curve(shuffled, view=view, iou_threshold=0.5)
    assert (a.average_precision, a.average_precision_heading) == (b.average_precision, b.average_precision_heading)
    assert a.heading_precision.tobytes() == b.heading_precision.tobytes() and 0.0 < a.average_precision < 1.0


@pytest.mark.parametrize("seed", range(4))
def test_a_turn_about_the_sensor_changes_nothing(seed: int) -> None:
    made = _random_frame(seed)
    turn = 0.8

    def turned(boxes: np.ndarray) -> np.ndarray:
        result = boxes.copy()
        result[:, 0] = np.cos(turn) * boxes[:, 0] - np.sin(turn) * boxes[:, 1]
        result[:, 1] = np.sin(turn) * boxes[:, 0] + np.cos(turn) * boxes[:, 1]
        result[:, 6] += turn
        return result

    truth, found = made.truth, made.found
    moved = DetectedFrame(
        made.scene,
        type(truth)(turned(truth.boxes), truth.num_points, truth.counts, truth.difficulty, truth.names),
        type(found)(turned(found.boxes), found.scores, found.labelled, found.image_height_px),
    )
    a, b = _curve(made, iou_threshold=0.5), _curve(moved, iou_threshold=0.5)
    assert a.average_precision == pytest.approx(b.average_precision, abs=1e-12)
    assert a.average_precision_heading == pytest.approx(b.average_precision_heading, abs=1e-9)


def test_an_assignment_without_conflicts_equals_that_of_every_cutoff() -> None:
    # The shortcut for frames without competition, against assignments made one by one.
    made = frame(cars(0, 10, 20, 30), cars(0.2, 30.3, 10.1), [0.95, 0.55, 0.75])
    assignment = assign(compare(made, "BEV"), 0.7, 0.0, 75.0)
    for number, matched in assignment.matched.items():
        kept = compare(made, "BEV").found
        alone = frame(made.truth.boxes, kept.boxes[:number], kept.scores[:number].tolist())
        expected = assign(compare(alone, "BEV"), 0.7, 0.0, 75.0).matched[number]
        assert matched.tolist() == expected.tolist()
