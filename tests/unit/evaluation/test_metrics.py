"""Every metric from the same detections: KITTI's difficulties and regions, the project's own, and their order."""

from __future__ import annotations

import numpy as np
import pytest
from frames_by_hand import cars, frame

from shift3d.evaluation.frames import DetectedFrame, compare
from shift3d.evaluation.metrics import Metric, evaluate, kitti_curve


def _kitti(made: DetectedFrame, difficulty: int) -> tuple[int, float | None, list[float]]:
    curve = kitti_curve([compare(made, "BEV")], 0.7, difficulty)
    return curve.num_truth, curve.average_precision, curve.precision.tolist()


def _one(frames: list[DetectedFrame], **which: object) -> Metric:
    found = [m for m in evaluate(frames) if all(getattr(m, key) == value for key, value in which.items())]
    assert len(found) == 1
    return found[0]


def test_kitti_difficulties_are_cumulative_and_ignore_what_is_harder() -> None:
    # Easy, moderate, hard, harder: all found; one false detection with the lowest score.
    made = frame(cars(0, 10, 20, 30), cars(0, 10, 20, 30, 60), [0.9, 0.8, 0.7, 0.6, 0.5], difficulty=[0, 1, 2, 3])
    assert _kitti(made, 0) == (1, 1.0, [1.0, 0.5])
    assert _kitti(made, 1) == (2, 1.0, pytest.approx([1.0, 1.0, 2 / 3]))
    assert _kitti(made, 2) == (3, 1.0, pytest.approx([1.0, 1.0, 1.0, 3 / 4]))


def test_kitti_vans_are_neither_right_nor_wrong() -> None:
    made = frame(cars(0, 10), cars(0, 10), [0.5, 0.9], difficulty=[0, 0], counts=[True, False])
    assert _kitti(made, 0) == (1, 1.0, [1.0])


def test_kitti_detections_outside_the_view_or_too_low_are_no_errors() -> None:
    low = [100.0, 39.0, 100.0]
    made = frame(
        cars(0), cars(0, 20, 40), [0.5, 0.9, 0.8], difficulty=[0], labelled=[True, True, False], image_height_px=low
    )
    assert _kitti(made, 0)[2] == [1.0]
    # 39 pixels are too low for easy alone.
    assert _kitti(made, 1)[2] == [0.0, 0.5]


def test_kitti_misses_count() -> None:
    # One of four found: precision 1 up to recall 1/4, the first ten of 40 positions.
    made = frame(cars(0, 10, 20, 30), cars(10), [0.9], difficulty=[0, 0, 0, 0])
    assert _kitti(made, 0)[:2] == (4, pytest.approx(0.25))


def test_the_projects_own_metric_counts_near_vehicles_with_twenty_points() -> None:
    # Near and dense; near and sparse (19 points); far. All found, one false near, one false far.
    made = frame(cars(10, 20, 60), cars(10, 20, 60, 40, 70), [0.9, 0.9, 0.9, 0.8, 0.95], points=[20, 19, 50])
    curve = _one([made], protocol="shift3d", view="BEV", iou_threshold=0.7).curve
    assert curve.num_truth == 1 and curve.average_precision == 1.0
    assert curve.precision.tolist() == [1.0, 0.5]  # the false one at 40 m alone


def test_kitti_rows_follow_waymos_levels_where_labels_have_no_difficulty() -> None:
    plain = frame(cars(10, 60), cars(10, 60), [0.9, 0.8], points=[3, 50])
    assert {m.subset for m in evaluate([plain]) if m.protocol == "kitti"} == {"LEVEL_1", "LEVEL_2"}
    assert (
        _one(
            [plain], protocol="kitti", view="3D", iou_threshold=0.5, subset="LEVEL_2", max_range_m=50.0
        ).curve.num_truth
        == 1
    )
    graded = frame(cars(10), cars(10), [0.9], difficulty=[1])
    kitti = [m for m in evaluate([graded]) if m.protocol == "kitti"]
    assert {m.subset for m in kitti} == {"easy", "moderate", "hard"}
    assert all(m.max_range_m is None for m in kitti)
    easy = _one([graded], protocol="kitti", view="BEV", iou_threshold=0.7, subset="easy")
    assert easy.curve.average_precision is None


def test_every_metric_of_a_perfect_detector_is_one_and_of_a_blind_one_zero() -> None:
    boxes = np.concatenate([cars(*(10.0 + 8.0 * i for i in range(8)), y=side) for side in (-4.0, 4.0)])
    perfect = list(evaluate([frame(boxes, boxes, [0.9] * 16), frame(boxes, boxes, [0.7] * 16)]))
    for metric in perfect:
        assert metric.curve.average_precision == pytest.approx(1.0), metric
        assert metric.curve.average_precision_heading == pytest.approx(1.0), metric
    blind = list(evaluate([frame(boxes, cars(), [])]))
    assert all(metric.curve.average_precision == 0.0 for metric in blind)
    assert [m.curve.num_truth * 2 for m in blind] == [m.curve.num_truth for m in perfect]
    nothing = list(evaluate([frame(cars(), cars(5), [0.9])]))
    assert all(metric.curve.average_precision is None for metric in nothing)
    # Each key once, and the same keys for any frames.
    keys = [(m.protocol, m.view, m.subset, m.iou_threshold, m.min_range_m, m.max_range_m) for m in perfect]
    assert len(set(keys)) == len(keys)
    assert keys == [(m.protocol, m.view, m.subset, m.iou_threshold, m.min_range_m, m.max_range_m) for m in nothing]


def test_values_are_ordered_as_their_definitions_say() -> None:
    # For any detector: 3D and the higher IoU are never easier, and headings never add.
    rng = np.random.default_rng(5)
    frames = []
    for _ in range(6):
        truth = cars(*np.cumsum(rng.uniform(6.0, 14.0, 6)), y=float(rng.uniform(-9, 9)))
        moved = truth + rng.normal(0, 1, truth.shape) * np.array([0.2, 0.1, 0.15, 0.1, 0.05, 0.1, 0.4])
        wrong = cars(*rng.uniform(-60, -5, 4))
        frames.append(frame(truth, np.concatenate((moved, wrong)), rng.uniform(0.05, 0.95, 10).tolist()))
    values = {
        (m.protocol, m.subset, m.min_range_m, m.max_range_m, m.view, m.iou_threshold): m.curve for m in evaluate(frames)
    }
    spread = 0
    for (*which, view, iou_threshold), curve in values.items():
        assert curve.average_precision_heading <= curve.average_precision + 1e-12
        if view == "3D":
            assert curve.average_precision <= values[*which, "BEV", iou_threshold].average_precision + 1e-12
        if iou_threshold == 0.7:
            easier = values[*which, view, 0.5].average_precision
            assert curve.average_precision <= easier + 1e-12
            spread += curve.average_precision < easier
    assert spread > 0
