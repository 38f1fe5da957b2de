"""How well a detector finds vehicles: average precision on procedural streets and on labelled real frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import numpy.typing as npt
import torch

from shift3d.detectors.base import Detector
from shift3d.evaluation.average_precision import (
    AveragePrecision,
    FrameMatches,
    average_precision,
    match_frame,
)
from shift3d.scenes.kitti import KittiScenes
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import StreetScenes
from shift3d.training.detector_scenes import network_points

__all__ = ["DetectorScore", "EvaluationRules", "evaluate_kitti", "evaluate_scenes", "evaluate_street"]

Boxes = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class EvaluationRules:
    """What counts: vehicles within max_range_m with at least min_points; a match at iou_threshold in BEV.

    Detections below score_threshold are not looked at. Vehicles that do not count are ignored: finding them
    is neither right nor wrong.
    """

    iou_threshold: float = 0.7
    max_range_m: float = 50.0
    min_points: int = 20
    score_threshold: float = 0.05


@dataclass(frozen=True)
class DetectorScore:
    """Average precision, the scenes it was taken over, and the median time of a detection."""

    average_precision: AveragePrecision
    scenes: int
    detect_ms: float


def evaluate_scenes(
    detector: Detector,
    scenes: Iterable[Scene],
    rules: EvaluationRules,
    labelled: Callable[[Scene, Boxes], Flags] | None = None,
    counts: Callable[[Scene], Flags] | None = None,
) -> DetectorScore:
    """Average precision over scenes.

    labelled: (scene, boxes (K, 7) in the scene frame) -> (K,) whether labels exist where a box stands;
    detections elsewhere are dropped. counts: (scene) -> (V,) which vehicles, in label order, count at all.
    Source: our choice (the project's own target); matching rules in shift3d.evaluation.average_precision.
    """
    frames: list[FrameMatches] = []
    milliseconds: list[float] = []
    window = detector.window_for((0.0, 0.0), rules.max_range_m + 2.0)
    for scene in scenes:
        points = torch.from_numpy(network_points(scene)[scene.has_beam])
        start = perf_counter()
        found = detector.detect(points, window, rules.score_threshold)
        milliseconds.append(1e3 * (perf_counter() - start))
        boxes = found.boxes.copy()
        boxes[:, 2] += scene.ground_z_m
        truth = scene.labels.of_class("vehicle").reshape(-1, 7)
        truth_counts = _near(truth, rules.max_range_m)
        truth_counts &= scene.labels.num_points[scene.labels.mask("vehicle")] >= rules.min_points
        if counts is not None:
            truth_counts &= counts(scene)
        boxes_count = _near(boxes, rules.max_range_m)
        if labelled is not None:
            boxes_count &= labelled(scene, boxes)
        frames.append(match_frame(boxes, found.scores, truth, truth_counts, boxes_count, rules.iou_threshold))
    median = float(np.median(milliseconds)) if milliseconds else float("nan")
    return DetectorScore(average_precision(frames), len(frames), median)


def _near(boxes: Boxes, max_range_m: float) -> Flags:
    near: Flags = np.hypot(boxes[:, 0], boxes[:, 1]) <= max_range_m
    return near


def evaluate_street(
    detector: Detector, count: int = 200, split: str = "test", rules: EvaluationRules | None = None
) -> DetectorScore:
    """Average precision at BEV IoU 0.7 on held-out procedural scenes of both sensors."""
    scenes = StreetScenes("mixed", count=count, split=split)
    return evaluate_scenes(detector, (scenes.load(name) for name in scenes.names()), rules or EvaluationRules())


def evaluate_kitti(detector: Detector, root: Path, rules: EvaluationRules | None = None) -> DetectorScore:
    """Average precision at BEV IoU 0.5 on labelled KITTI frames, inside the camera's view alone.

    Cars count; vans and other vehicles are ignored, as KITTI does. Raises: InputError for bad frames.
    """
    scenes = KittiScenes(root)

    def labelled(scene: Scene, boxes: Boxes) -> Flags:
        return scenes.camera_view(scene.scene_id).in_view(boxes)

    def is_car(scene: Scene) -> Flags:
        names = np.asarray(scene.labels.names, dtype=object)
        flags: Flags = names[scene.labels.mask("vehicle")] == "Car"
        return flags

    frames = (scenes.load(name) for name in scenes.names())
    return evaluate_scenes(detector, frames, rules or EvaluationRules(iou_threshold=0.5), labelled, is_car)
