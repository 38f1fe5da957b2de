"""The shipped weights find held-out vehicles, on the procedural street and on real frames."""

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from shift3d.detectors.base import BevWindow
from shift3d.detectors.loading import load_detector
from shift3d.detectors.models.weights import WEIGHTS_FOLDER
from shift3d.detectors.names import DETECTOR_NAMES
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.geometry.iou import iou_bev
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import StreetScenes

RADIUS_M = 30.0
WELL_SEEN = 100
SHIPPED = [name for name in DETECTOR_NAMES if (WEIGHTS_FOLDER / f"{name}.safetensors").is_file()]


shipped = functools.cache(load_detector)


@functools.cache
def streets(sensor: str) -> list[Scene]:
    """Return streets with nine well visible vehicles, which every detector receives."""
    scenes = StreetScenes(sensor, count={"hdl64": 1, "waymo_top": 2}[sensor], split="test")
    return [scenes.load(name) for name in scenes.names()]


@pytest.fixture
def detector() -> TrainedDetector:
    return shipped("pointpillars")


def _found(detector: TrainedDetector, scene: Scene, iou_threshold: float) -> np.ndarray:
    """Return the best score of a box that overlaps each well visible vehicle within the radius enough, else 0."""
    points = torch.from_numpy(scene.points[scene.has_beam]) - torch.tensor([0.0, 0.0, scene.ground_z_m])
    found = detector.detect(points, detector.window_for((0.0, 0.0), RADIUS_M + 3.0))
    mask = scene.labels.mask("vehicle") & (scene.labels.num_points >= WELL_SEEN)
    truth = scene.labels.boxes[mask]
    truth = truth[np.hypot(truth[:, 0], truth[:, 1]) < RADIUS_M]
    overlap = iou_bev(truth, found.boxes) >= iou_threshold
    return np.where(overlap, found.scores, 0.0).max(axis=1, initial=0.0)


@pytest.mark.parametrize("sensor", ["hdl64", "waymo_top"])
@pytest.mark.parametrize(("name", "overlap"), [("pointpillars", 0.7), ("sst", 0.5), ("sst_small", 0.5)])
def test_finds_vehicles_of_held_out_streets(name: str, overlap: float, sensor: str) -> None:
    """SST places boxes less accurately: its threshold is IoU 0.5."""
    scores = np.concatenate([_found(shipped(name), scene, overlap) for scene in streets(sensor)])
    assert len(scores) == 9
    assert np.mean(scores > 0.3) >= 0.8
    assert 0.5 <= np.median(scores) <= 0.97  # neither blind nor saturated


@pytest.mark.parametrize("name", SHIPPED)
def test_finds_nothing_where_nothing_is_not_even_at_the_edge_of_the_grid(name: str) -> None:
    """Layers read zeros beside the grid, which must not cause detections."""
    ranges = 1.9 / np.tan(np.deg2rad(np.arange(1.5, 20.0, 0.4)))  # of beams at 1.9 m that meet flat ground
    bearings = np.linspace(-np.pi, np.pi, 900)
    ground = np.stack([np.outer(ranges, wave(bearings)).ravel() for wave in (np.cos, np.sin)], axis=1)
    found = shipped(name).detect(torch.from_numpy(np.pad(ground, ((0, 0), (0, 1)))).float())
    assert found.scores.max(initial=0.0) < 0.2


def test_finds_cars_of_real_frames(detector: TrainedDetector, real_data: Callable[[str], Path]) -> None:
    scenes = KittiScenes(real_data("kitti"), names=["000134", "004240", "002079"])
    scores = np.concatenate([_found(detector, scenes.load(name), 0.5) for name in scenes.names()])
    assert len(scores) >= 3
    assert np.mean(scores > 0.3) >= 0.6


def test_an_empty_world_holds_no_vehicle(detector: TrainedDetector) -> None:
    window = detector.window_for((0.0, 0.0), 10.0)
    found = detector.detect(torch.zeros(0, 3), window, score_threshold=0.3)
    assert len(found.scores) == 0


def _scores(detector: TrainedDetector, points: torch.Tensor, window: BevWindow) -> torch.Tensor:
    with torch.no_grad():
        return torch.sigmoid(detector.proposals(points, window).logits)


@pytest.mark.parametrize("name", SHIPPED)
def test_scores_are_the_same_to_the_bit(name: str) -> None:
    """Scores are equal in five runs with points in other orders on one thread, and to rounding on two threads."""
    detector, street = shipped(name), streets("waymo_top")[0]
    points = torch.from_numpy(street.points[street.has_beam]) - torch.tensor([0.0, 0.0, street.ground_z_m])
    vehicle = street.labels.boxes[street.labels.mask("vehicle")][0]
    window = detector.window_for((float(vehicle[0]), float(vehicle[1])), 5.0)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        first = _scores(detector, points, window)
        assert first.max() - first.min() > 0.1
        for seed in range(4):
            order = torch.randperm(len(points), generator=torch.Generator().manual_seed(seed))
            assert torch.equal(_scores(detector, points[order], window), first)
        torch.set_num_threads(2)
        assert (_scores(detector, points, window) - first).abs().max() <= 1e-5
    finally:
        torch.set_num_threads(threads)
