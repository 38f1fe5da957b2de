"""A crop's variations: each moves points and boxes together, and a range of one value changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from shift3d.detectors.grid import WAYMO_GRID, cells_of
from shift3d.geometry.boxes import points_in_boxes
from shift3d.training.detector.crops import augment_vehicles, drop_points, moved, random_crop, vehicle_centre
from shift3d.training.detector.recipe import Augmentation, Recipe
from shift3d.training.detector_scenes import TrainingScene

NONE = Augmentation(
    turn_rad=(0.0, 0.0), flip=0.0, scale=(1.0, 1.0), object_scale=(1.0, 1.0), shift_m=0.0, ground_shift_m=(0.0, 0.0),
    ground_slope=0.0, kept_points=(1.0, 1.0), dropped_lines=0.0, range_noise_m=(0.0, 0.0), swallowed=0.0, pasted=0,
)  # fmt: skip
BOXES = np.array([[10, 3, 0.8, 4.5, 1.8, 1.6, 0.4], [20, -8, 0.9, 4.2, 1.7, 1.5, 2.0]], dtype=np.float32)


def _inside(boxes: np.ndarray, rng: np.random.Generator, count: int = 300) -> np.ndarray:
    clouds = []
    for box in boxes:
        local = rng.uniform(-0.49, 0.49, (count, 3)) * box[3:6]
        cos, sin = np.cos(box[6]), np.sin(box[6])
        local[:, :2] = local[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        clouds.append(local + box[:3])
    return np.concatenate(clouds).astype(np.float32)


POINTS = _inside(BOXES, np.random.default_rng(0))


def test_ranges_of_one_value_change_nothing() -> None:
    rng = np.random.default_rng(0)
    assert np.array_equal(drop_points(POINTS, 1.8, NONE, rng), POINTS)
    points, boxes = augment_vehicles(POINTS, BOXES, NONE, rng)
    points, boxes = moved(points, boxes, (0.0, False, 1.0), NONE, rng)
    assert np.allclose(points, POINTS, atol=1e-6) and np.allclose(boxes, BOXES, atol=1e-6)


@pytest.mark.parametrize("move", [(2.3, False, 1.0), (0.0, True, 1.0), (-0.4, True, 0.9)])
def test_points_stay_in_their_boxes_wherever_these_go(move: tuple[float, bool, float]) -> None:
    varied = replace(NONE, shift_m=0.3, ground_shift_m=(-0.2, 0.4))
    points, boxes = moved(POINTS, BOXES, move, varied, np.random.default_rng(1))
    assert not np.allclose(boxes[:, :2], BOXES[:, :2])
    assert np.allclose(boxes[:, 3:6], move[2] * BOXES[:, 3:6])
    assert (points_in_boxes(points, boxes, 1e-3).reshape(2, 2, 300).sum(axis=2) == [[300, 0], [0, 300]]).all()


def test_a_scaled_vehicle_keeps_its_bottom_and_its_points() -> None:
    points, boxes = augment_vehicles(POINTS, BOXES, replace(NONE, object_scale=(1.2, 1.2)), np.random.default_rng(0))
    assert np.allclose(boxes[:, 3:6], 1.2 * BOXES[:, 3:6]) and np.allclose(boxes[:, 6], BOXES[:, 6])
    assert np.allclose(boxes[:, 2] - boxes[:, 5] / 2, BOXES[:, 2] - BOXES[:, 5] / 2, atol=1e-6)
    assert np.allclose(boxes[:, :2], BOXES[:, :2])
    assert points_in_boxes(points, boxes, 1e-3).sum() == 600
    assert points_in_boxes(points, BOXES).sum() < 500


def test_a_stretched_vehicle_keeps_its_heading_and_its_points_their_places_in_the_box() -> None:
    """Each axis of a box has its own factor, and points keep their shares of length, width and height."""
    stretched = replace(NONE, object_stretch=(0.7, 1.3))
    points, boxes = augment_vehicles(POINTS, BOXES, stretched, np.random.default_rng(0))
    factors = boxes[:, 3:6] / BOXES[:, 3:6]
    assert (np.abs(factors[:, None] - factors[:, :, None])[:, [0, 0, 1], [1, 2, 2]] > 0.01).all()
    assert np.allclose(boxes[:, 2] - boxes[:, 5] / 2, BOXES[:, 2] - BOXES[:, 5] / 2, atol=1e-6)
    assert np.allclose(boxes[:, [0, 1, 6]], BOXES[:, [0, 1, 6]])

    def shares(cloud: np.ndarray, box: np.ndarray) -> np.ndarray:
        cos, sin = np.cos(box[6]), np.sin(box[6])
        return (cloud - box[:3]) @ np.array(((cos, -sin, 0), (sin, cos, 0), (0, 0, 1))) / box[3:6]

    for row, part in enumerate((slice(0, 300), slice(300, 600))):
        assert np.allclose(shares(points[part], boxes[row]), shares(POINTS[part], BOXES[row]), atol=1e-4)


def test_length_width_and_height_are_stretched_within_their_own_ranges() -> None:
    own = replace(NONE, object_stretch=(0.8, 0.9, 1.0, 1.0, 1.1, 1.2))
    rng = np.random.default_rng(0)
    factors = np.concatenate([augment_vehicles(POINTS, BOXES, own, rng)[1][:, 3:6] for _ in range(50)])
    factors /= np.tile(BOXES[:, 3:6], (50, 1))
    assert np.allclose(factors.min(axis=0), (0.8, 1.0, 1.1), atol=0.01)
    assert np.allclose(factors.max(axis=0), (0.9, 1.0, 1.2), atol=0.01)


def test_dropped_scan_lines_are_whole() -> None:
    """Points are on lines of known elevation: a line is dropped or kept as a whole."""
    elevation = np.deg2rad(np.repeat(np.arange(-20, 2, 0.2), 50))
    azimuth = np.tile(np.linspace(-3, 3, 50), len(elevation) // 50)
    range_m = 20.0
    points = range_m * np.stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)), axis=1
    )
    points[:, 2] += 1.8
    kept = drop_points(points.astype(np.float32), 1.8, replace(NONE, dropped_lines=1.0), np.random.default_rng(3))
    lines, counts = np.unique(np.rint(np.rad2deg(np.arcsin((kept[:, 2] - 1.8) / range_m)) * 5), return_counts=True)
    assert 0 < len(lines) < len(points) // 50 and set(counts.tolist()) == {50}


def test_near_and_far_vehicles_are_drawn_alike() -> None:
    near = np.tile(BOXES[:1], (20, 1))
    near[:, 0] = np.linspace(8, 28, 20)
    far = BOXES[:1].copy()
    far[:, 0] = 60.0
    boxes = np.concatenate((near, far))
    scene = TrainingScene(_inside(boxes, np.random.default_rng(0), 20), boxes, 1.8)
    rng = np.random.default_rng(0)
    drawn = [vehicle_centre(scene, (0.0, 30.0, 50.0, 75.0), 5, rng) for _ in range(400)]
    share = np.mean([centre is not None and centre[0] > 50 for centre in drawn])
    assert share == pytest.approx(0.5, abs=0.08)
    unseen = replace(scene, points=scene.points[scene.points[:, 0] > 40])
    assert all(vehicle_centre(unseen, (30.0, 75.0), 5, rng)[0] == 60.0 for _ in range(5))  # type: ignore[index]
    nothing = replace(scene, points=np.zeros((0, 3), np.float32))
    assert vehicle_centre(nothing, (0.0, 75.0), 5, rng) is None


def test_a_plain_crop_is_the_scene_around_a_vehicle() -> None:
    scene = TrainingScene(POINTS, BOXES, 1.8)
    recipe = Recipe(crop_cells=64, jitter_m=0.0, empty_share=0.0, augmentation=NONE)
    crop = random_crop(scene, WAYMO_GRID, recipe, np.random.default_rng(0))
    assert crop.usable.all() and np.allclose(crop.boxes, BOXES, atol=1e-5)
    low = WAYMO_GRID.x_min_m + crop.window.x0 * WAYMO_GRID.cell_m
    middle = low + 32 * WAYMO_GRID.cell_m
    assert np.abs(BOXES[:, 0] - middle).min() <= 2 * WAYMO_GRID.cell_m


@pytest.mark.parametrize("vehicle_x", [20.0, 60.0, 71.0])
def test_a_window_at_the_edge_of_the_grid_has_all_of_its_points(vehicle_x: float) -> None:
    ground = np.random.default_rng(1).uniform((-74, -74, 0.0), (74, 74, 0.1), (60_000, 3)).astype(np.float32)
    boxes = np.array([[vehicle_x, -60.0, 0.8, 4.5, 1.8, 1.6, 0.4]], dtype=np.float32)
    scene = TrainingScene(np.concatenate((ground, _inside(boxes, np.random.default_rng(2)))), boxes, 1.8)
    recipe = Recipe(crop_cells=64, jitter_m=5.0, empty_share=0.0, augmentation=NONE)
    for seed in range(20):
        crop = random_crop(scene, WAYMO_GRID, recipe, np.random.default_rng(seed))
        _, _, seen = cells_of(torch.from_numpy(scene.points), WAYMO_GRID, crop.window)
        assert len(crop.points_inside(WAYMO_GRID)) == int(seen.sum())


def test_crops_without_a_vehicle_lie_anywhere_up_to_the_farthest_range_bin() -> None:
    ground = np.random.default_rng(0).uniform((-80, -80, 0), (80, 80, 0.02), (4000, 3)).astype(np.float32)
    scene = TrainingScene(ground, np.zeros((0, 7), np.float32), 1.8)
    recipe = Recipe(augmentation=replace(NONE, range_bins_m=(0.0, 60.0)), crop_cells=16)
    rng = np.random.default_rng(0)
    windows = [random_crop(scene, WAYMO_GRID, recipe, rng).window for _ in range(200)]
    middles = np.array([[window.x0 + 8, window.y0 + 8] for window in windows]) * WAYMO_GRID.cell_m + WAYMO_GRID.x_min_m
    assert 55.0 < np.abs(middles).max() < 61.0
    assert np.percentile(np.abs(middles), 50) == pytest.approx(30.0, abs=3.0)
