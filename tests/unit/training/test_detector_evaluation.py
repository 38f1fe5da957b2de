"""Evaluation of a detector over scenes: frames, filters and regions, with detectors whose answer is known."""

import numpy as np
import pytest
import torch

from shift3d.detectors.base import BevWindow, Detections, Proposals
from shift3d.scenes.labels import Labels
from shift3d.scenes.scene import Scene
from shift3d.training.detector_evaluation import EvaluationRules, evaluate_scenes
from shift3d.training.detector_scenes import from_scene, network_points

GROUND_Z_M = -1.73


def _scene() -> Scene:
    """Vehicles near, sparse (5 points), far (60 m), and a pedestrian."""
    boxes = np.array(
        [
            [10.0, 5.0, -0.93, 4.5, 1.8, 1.6, 0.3],
            [-20.0, 5.0, -0.93, 4.5, 1.8, 1.6, 2.0],
            [60.0, 0.0, -0.93, 4.5, 1.8, 1.6, 0.0],
            [8.0, -5.0, -0.83, 0.8, 0.8, 1.8, 0.0],
        ]
    )
    rng = np.random.default_rng(0)
    points = rng.uniform((-40, -40, GROUND_Z_M), (40, 40, 0), (300, 3)).astype(np.float32)
    points[0] = 0.0  # carries no beam
    return Scene(
        scene_id="made",
        dataset="made",
        points=points,
        origins=np.zeros_like(points),
        ground_z_m=GROUND_Z_M,
        labels=Labels(boxes, ("vehicle", "vehicle", "vehicle", "pedestrian"), np.array([50, 5, 50, 50], np.int32)),
    )


class _Known:
    """Answers with given network-frame boxes, and notes what it was asked."""

    name = "known"

    def __init__(self, boxes: np.ndarray, scores: list[float]) -> None:
        self.boxes, self.scores, self.asked = boxes, np.array(scores, dtype=float), []

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        assert centre_xy == (0.0, 0.0) and radius_m >= 50.0
        return BevWindow(0, 0, 4, 4, 0, 0, 4, 4)

    def proposals(self, points: torch.Tensor, window: BevWindow | None = None) -> Proposals:
        raise NotImplementedError

    def detect(
        self,
        points: torch.Tensor,
        window: BevWindow | None = None,
        score_threshold: float = 0.1,
        iou_threshold: float = 0.25,
    ) -> Detections:
        self.asked.append(points)
        return Detections(self.boxes, self.scores)


def _network(boxes: np.ndarray) -> np.ndarray:
    return boxes + np.array([0, 0, -GROUND_Z_M, 0, 0, 0, 0])


def test_only_near_vehicles_with_enough_points_count() -> None:
    truth = _scene().labels.boxes
    detector = _Known(_network(truth[:3]), [0.9, 0.8, 0.7])
    score = evaluate_scenes(detector, [_scene()], EvaluationRules())
    assert score.average_precision.num_truth == 1 and score.average_precision.value == 1.0
    assert score.average_precision.precision.tolist() == [1.0]  # the ignored two are no errors
    assert score.scenes == 1 and score.detect_ms >= 0.0
    assert len(detector.asked[0]) == 299
    assert detector.asked[0][:, 2].min() >= -1e-3  # the ground is at zero


def test_detections_without_a_vehicle_are_errors_inside_the_range_alone() -> None:
    wrong = np.array([[30.0, 0, 0.8, 4, 2, 1.6, 0], [70.0, 0, 0.8, 4, 2, 1.6, 0]])
    boxes = np.concatenate((wrong, _network(_scene().labels.boxes[:1])))
    score = evaluate_scenes(_Known(boxes, [0.9, 0.8, 0.7]), [_scene()], EvaluationRules())
    assert score.average_precision.precision.tolist() == [0.0, 0.5]
    assert score.average_precision.value == pytest.approx(0.5)


def test_regions_and_classes_restrict_what_counts() -> None:
    truth = _scene().labels.boxes
    boxes = np.concatenate((_network(truth[:1]), [[30.0, 0, 0.8, 4, 2, 1.6, 0]]))

    def labelled(scene: Scene, found: np.ndarray) -> np.ndarray:
        assert found[0, 2] == pytest.approx(truth[0, 2])  # back in the scene frame
        return found[:, 0] < 20.0

    score = evaluate_scenes(_Known(boxes, [0.5, 0.9]), [_scene()], EvaluationRules(), labelled=labelled)
    assert score.average_precision.value == 1.0
    nothing = evaluate_scenes(
        _Known(boxes, [0.5, 0.9]), [_scene()], EvaluationRules(), counts=lambda scene: np.zeros(3, dtype=bool)
    )
    assert nothing.average_precision.num_truth == 0 and np.isnan(nothing.average_precision.value)


def test_training_scenes_are_in_the_network_frame() -> None:
    scene = _scene()
    made = from_scene(scene)
    assert made.sensor_height_m == pytest.approx(1.73)
    assert len(made.points) == 299 and made.boxes.shape == (3, 7)
    assert np.allclose(made.boxes, _network(scene.labels.boxes[:3]), atol=1e-5)
    assert np.array_equal(network_points(scene)[1:], made.points)
