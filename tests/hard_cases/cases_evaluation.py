"""Hard cases of the metrics: no score, equal scores, nothing to find, nothing found."""

from __future__ import annotations

import math

import numpy as np
from catalogue import hard_case

from shift3d.evaluation.average_precision import PrecisionRecall, area_exact, area_r40, greedy_curve, match_frame
from shift3d.evaluation.bev_grid import bev_grid
from shift3d.evaluation.frames import DetectedFrame, FrameDetections, GroundTruth, compare, heading_accuracy
from shift3d.evaluation.metrics import evaluate
from shift3d.evaluation.recall_curve import area_under, recall_curve
from shift3d.evaluation.waymo import assign, waymo_curve

AREA = "evaluation"


def cars(*x_m: float, heading: float = 0.0) -> np.ndarray:
    """Return (N, 7) cars in a row along x."""
    return np.array([[x, 0.0, 0.8, 4.0, 2.0, 1.6, heading] for x in x_m]).reshape(-1, 7)


def frame(truth: np.ndarray, found: np.ndarray, *scores: float, points: int = 20) -> DetectedFrame:
    count, boxes = len(truth), len(found)
    return DetectedFrame(
        "made",
        GroundTruth(truth, np.full(count, points), np.ones(count, bool), np.full(count, -1), ("Car",) * count),
        FrameDetections(found, np.array(scores, dtype=float), np.ones(boxes, bool), np.full(boxes, np.nan)),
    )


def curve_of(*frames: DetectedFrame, at_40_recalls: bool = False) -> PrecisionRecall:
    """Return the greedy curve in which every vehicle and every detection counts."""
    matches = [
        match_frame(compare(one, "BEV"), np.ones(len(one.truth.boxes), bool), np.ones(len(one.found.boxes), bool), 0.5)
        for one in frames
    ]
    return greedy_curve(matches, at_40_recalls)


def refused(call: object, *arguments: object) -> bool:
    try:
        call(*arguments)  # type: ignore[operator]
    except ValueError:
        return True
    return False


@hard_case(
    area=AREA,
    why="the whole curve is one step, and the threshold at the step is one of its scores",
    must="recall is 1 below the score and 0 from it on, and the area is the score",
    guard="a detection scores more than the threshold: ties with it are left out",
)
def all_detection_scores_equal() -> None:
    for score in (0.0, 1e-300, 0.3, 1.0 - 2.0**-53, 1.0):
        curve = recall_curve([score] * 7)
        assert math.isclose(area_under(curve), score, rel_tol=1e-15)
        assert set(curve.recall.tolist()) <= {0.0, 1.0} and curve.recall[-1] == 0.0
        assert curve.score_threshold[0] == 0.0 and curve.score_threshold[-1] == 1.0


@hard_case(
    area=AREA,
    why="a NaN is neither below 0 nor above 1, and would pass for a vehicle that was missed",
    must="it is refused",
    guard="scores must lie in [0, 1], which a NaN does not",
)
def a_score_of_nan() -> None:
    for bad in (math.nan, math.inf, -1e-300, 1.0 + 2.0**-52):
        assert refused(recall_curve, [0.5, bad, 0.7])


@hard_case(
    area=AREA,
    why="the share of none is 0/0",
    must="a curve of no score is refused, not drawn",
    guard="an empty list is refused by name",
)
def no_score_at_all() -> None:
    with np.errstate(all="ignore"):
        assert refused(recall_curve, []) and refused(recall_curve, np.zeros((0, 3)))


@hard_case(
    area=AREA,
    why="without a vehicle there is no recall: 0 would say that all were missed",
    must="no average precision, whatever was found",
    guard="the area is taken only where there is something to find",
)
def nothing_to_find() -> None:
    for found in (frame(cars(), cars()), frame(cars(), cars(10.0, 20.0), 0.9, 0.4)):
        for at_40 in (False, True):
            curve = curve_of(found, at_40_recalls=at_40)
            assert curve.average_precision is None and curve.average_precision_heading is None
            assert np.isfinite(curve.recall).all() and np.isfinite(curve.precision).all()
        assert all(metric.curve.average_precision is None for metric in evaluate([found]))
    assert all(metric.curve.average_precision is None for metric in evaluate([]))


@hard_case(
    area=AREA,
    why="a curve without a point has no last one of a tie",
    must="an average precision of 0 for the vehicles that nobody found",
    guard="the end of the last tie is cut off where there is no score",
)
def nothing_found() -> None:
    missed = frame(cars(10.0, 20.0), cars())
    for at_40 in (False, True):
        curve = curve_of(missed, at_40_recalls=at_40)
        assert curve.average_precision == curve.average_precision_heading == 0.0 and curve.recall.size == 0
    assert {metric.curve.average_precision for metric in evaluate([missed])} <= {0.0, None}
    assert area_exact(np.empty(0), np.empty(0)) == area_r40(np.empty(0), np.empty(0)) == 0.0


@hard_case(
    area=AREA,
    why="of a right and a wrong detection with one score, either may come first",
    must="they enter together: precision 1/2 at recall 1, in whatever order they are given",
    guard="the curve has one point for all detections of a score",
)
def a_right_and_a_wrong_detection_with_one_score() -> None:
    for found in (cars(10.0, 30.0), cars(30.0, 10.0)):
        curve = curve_of(frame(cars(10.0), found, 0.5, 0.5))
        assert (curve.recall.tolist(), curve.precision.tolist()) == ([1.0], [0.5])
        assert curve.score_threshold.tolist() == [0.5] and curve.average_precision == 0.5


@hard_case(
    area=AREA,
    why="two detections of one vehicle with one score: which of them is right depends on which comes first",
    must="the same curve in whatever order they are given",
    guard="equal scores are ordered by their boxes",
)
def two_detections_of_one_vehicle_with_one_score() -> None:
    near, turned = cars(10.4), cars(10.0, heading=math.pi)
    orders = ((near, turned), (turned, near))
    curves = [curve_of(frame(cars(10.0), np.concatenate(boxes), 0.5, 0.5)) for boxes in orders]
    assert curves[0].average_precision_heading == curves[1].average_precision_heading
    assert curves[0].heading_precision.tolist() == curves[1].heading_precision.tolist()


@hard_case(
    area=AREA,
    why="headings of nearly pi and nearly -pi point the same way, and differ by nearly a turn",
    must="full accuracy where they point the same way, 0 where they are opposed, for any number of turns",
    guard="the difference is taken the shorter way round",
)
def headings_on_both_sides_of_the_half_turn() -> None:
    headings = np.array([math.pi - 1e-9, -math.pi + 1e-9, math.pi + 10 * math.pi, 1e-9, -1e-9])
    boxes = np.concatenate([cars(0.0, heading=heading) for heading in headings])
    expected = 1.0 - np.arccos(np.clip(np.cos(headings[:, None] - headings), -1.0, 1.0)) / np.pi
    assert np.abs(heading_accuracy(boxes, boxes) - expected).max() < 1e-7


@hard_case(
    area=AREA,
    why="a place without a number falls into a cell 10^19 m away, and spoils no other: nobody would see it",
    must="it is refused, and so is a score without a number",
    guard="positions and scores must be finite",
)
def a_vehicle_at_no_place() -> None:
    with np.errstate(invalid="ignore"):
        assert refused(bev_grid, [[math.nan, 1.0], [3.0, 4.0]], [0.9, 0.8], [0.1, 0.2])
        assert refused(bev_grid, [[1.0, math.inf], [3.0, 4.0]], [0.9, 0.8], [0.1, 0.2])
        assert refused(bev_grid, [[1.0, 1.0], [3.0, 4.0]], [0.9, 0.8], [math.nan, 0.2])
    empty = bev_grid(np.zeros((0, 2)), [], [])
    assert empty.corner_xy_m.shape == (0, 2) and empty.count.shape == (0,)


@hard_case(
    area=AREA,
    why="turned into an integer, -0.5 is 0: two cells on either side of the sensor would be one of twice the size",
    must="a cell holds its lower edges, on both sides of the sensor",
    guard="cells are taken by the floor",
)
def vehicles_on_the_edges_of_cells() -> None:
    places = [[0.0, 0.0], [-0.0, -0.0], [-1e-9, 0.0], [10.0, -10.0], [np.nextafter(10.0, 0.0), -10.0]]
    grid = bev_grid(places, np.ones(5), np.zeros(5))
    assert grid.corner_xy_m.tolist() == [[-10.0, 0.0], [0.0, -10.0], [0.0, 0.0], [10.0, -10.0]]
    assert grid.count.tolist() == [1, 1, 2, 1]


@hard_case(
    area=AREA,
    why="no detector can find a vehicle without a point on it",
    must="it is not requested, and a curve with no other vehicle has no value",
    guard="vehicles without a point do not take part",
)
def a_vehicle_without_a_point() -> None:
    hidden = frame(cars(10.0), cars(10.0), 0.9, points=0)
    curve = waymo_curve([assign(compare(hidden, "3D"), 0.5, 0.0, 75.0)], "LEVEL_2")
    assert curve.average_precision is None and curve.num_truth == 0
    assert not curve.recall.any()  # the box there is no true positive either
