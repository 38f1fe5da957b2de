"""Ground-truth sampling: a pasted vehicle is placed free on the ground, keeps its view, and hides points behind it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shift3d.geometry.boxes import points_in_boxes
from shift3d.geometry.iou import iou_bev
from shift3d.training.detector.pasting import VehicleDatabase, behind_box, pasted
from shift3d.training.detector.recipe import Augmentation
from shift3d.training.detector_scenes import TrainingScene, cache_scenes

HEIGHT_M = 1.8
SAME_RANGE = Augmentation(pasted=4, pasted_range=(1.0, 1.0001))


def _ground(rng: np.random.Generator, count: int = 60_000, z_m: float = 0.0) -> np.ndarray:
    return rng.uniform((-60, -60, z_m), (60, 60, z_m + 0.01), (count, 3)).astype(np.float32)


def _on(box: np.ndarray, rng: np.random.Generator, count: int = 400) -> np.ndarray:
    """Return points on the two faces of a box that a sensor at the origin sees best."""
    local = rng.uniform(-0.5, 0.5, (count, 3))
    side = rng.random(count) < 0.5
    to_sensor = -box[:2] @ np.array([[np.cos(box[6]), -np.sin(box[6])], [np.sin(box[6]), np.cos(box[6])]])
    local[side, 0] = 0.499 * np.sign(to_sensor[0])
    local[~side, 1] = 0.499 * np.sign(to_sensor[1])
    local *= box[3:6]
    cos, sin = np.cos(box[6]), np.sin(box[6])
    local[:, :2] = local[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    return (local + box[:3]).astype(np.float32)


def _box(x: float, y: float, heading: float, bottom: float = 0.0) -> np.ndarray:
    return np.array((x, y, bottom + 0.8, 4.5, 1.8, 1.6, heading), dtype=np.float32)


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> VehicleDatabase:
    rng = np.random.default_rng(0)

    def build(name: str) -> TrainingScene:
        boxes = np.stack([_box(15 + 5 * k + int(name), 4 * (-1) ** k, 0.7 * k) for k in range(6)])
        return TrainingScene(np.concatenate([_on(box, rng) for box in boxes]), boxes, HEIGHT_M)

    return VehicleDatabase.of(cache_scenes(tmp_path_factory.mktemp("scenes"), ["0", "1"], build), 5)


def _empty(seed: int = 0, z_m: float = 0.0) -> TrainingScene:
    return TrainingScene(_ground(np.random.default_rng(seed), z_m=z_m), np.zeros((0, 7), np.float32), HEIGHT_M)


def test_the_database_holds_every_vehicle_by_rising_range(database: VehicleDatabase) -> None:
    assert len(database.points) == len(database.boxes) == 12
    assert (np.diff(database.range_m) >= 0).all()
    for box, points in zip(database.boxes, database.points, strict=True):
        assert points_in_boxes(points, box[None], 0.01).all() and len(points) == 400


@pytest.mark.parametrize("ground_z_m", [0.0, -0.7])
def test_pasted_vehicles_stand_on_the_ground_and_touch_nothing(database: VehicleDatabase, ground_z_m: float) -> None:
    seen = 0
    for seed in range(30):
        scene = pasted(_empty(z_m=ground_z_m), database, np.array((25.0, 5.0)), 12.0, Augmentation(pasted=4), 5,
                       np.random.default_rng(seed))  # fmt: skip
        again = pasted(_empty(z_m=ground_z_m), database, np.array((25.0, 5.0)), 12.0, Augmentation(pasted=4), 5,
                       np.random.default_rng(seed))  # fmt: skip
        assert np.array_equal(scene.points, again.points) and np.array_equal(scene.boxes, again.boxes)
        seen += len(scene.boxes)
        assert len(scene.boxes) <= 4
        assert np.allclose(scene.boxes[:, 2] - scene.boxes[:, 5] / 2, ground_z_m, atol=0.02)
        assert (iou_bev(scene.boxes, scene.boxes) - np.eye(len(scene.boxes))).max(initial=0.0) == pytest.approx(0.0)
        for inside in points_in_boxes(scene.points, scene.boxes, 0.05):
            assert inside.sum() >= 5
    assert seen > 30


def test_a_vehicle_is_seen_from_the_side_that_was_measured(database: VehicleDatabase) -> None:
    """A vehicle pasted at the same range keeps its angle to the beam and its points' places in the box."""
    for seed in range(20):
        scene = pasted(_empty(), database, np.array((0.0, 24.0)), 8.0, SAME_RANGE, 5, np.random.default_rng(seed))
        for box in scene.boxes:
            source = int(np.argmin(np.abs(database.range_m - np.hypot(box[0], box[1]))))
            old = database.boxes[source]
            relative = [b[6] - np.arctan2(b[1], b[0]) for b in (box, old)]
            assert np.cos(relative[0] - relative[1]) == pytest.approx(1.0, abs=1e-3)


def test_points_thin_with_the_square_of_the_distance(database: VehicleDatabase) -> None:
    farther = Augmentation(pasted=1, pasted_range=(1.9, 2.1))
    counts = []
    for seed in range(60):
        scene = pasted(_empty(), database, np.array((45.0, 0.0)), 5.0, farther, 5, np.random.default_rng(seed))
        counts += [int(inside.sum()) for inside in points_in_boxes(scene.points, scene.boxes, 0.02)]
    # The ground under a box counts too, and its own shadow removes all of that.
    assert len(counts) > 10 and np.mean(counts) == pytest.approx(400 / 4, rel=0.15)


def test_nothing_is_left_behind_a_pasted_vehicle() -> None:
    """Points of a wall 10 m behind a box are removed only if the box hides them."""
    origin, box = np.array((0.0, 0.0, HEIGHT_M)), _box(20.0, 0.0, 0.0)
    y, z = (axis.reshape(-1) for axis in np.meshgrid(np.linspace(-6, 6, 121), np.linspace(0.01, 6, 121)))
    wall = np.stack((np.full_like(y, 30.0), y, z), axis=1).astype(np.float32)
    hidden = behind_box(wall, origin, box)
    # By similar triangles: the near face, at 17.75 m, is 0.9 m to either side, and the box's top is below the sensor.
    assert np.abs(wall[hidden, 1]).max() == pytest.approx(0.9 * 30 / 17.75, abs=0.06)
    top = HEIGHT_M - (HEIGHT_M - 1.6) * 30.0 / 22.25  # over the far edge of the roof
    assert wall[hidden, 2].max() == pytest.approx(top, abs=0.06)
    assert not behind_box(wall - np.float32([20, 0, 0]), origin, box).any()  # in front of it
    assert not behind_box(wall * np.float32([-1, 1, 1]), origin, box).any()  # behind the sensor
    assert behind_box(np.array([[20.0, 0.0, 0.5]], np.float32), origin, box).all()  # inside


def test_a_vehicle_behind_a_wall_is_not_pasted(database: VehicleDatabase) -> None:
    y, z = (axis.reshape(-1) for axis in np.meshgrid(np.linspace(-40, 40, 1601), np.linspace(0.0, 4, 81)))
    wall = np.stack((np.full_like(y, 10.0), y, z), axis=1).astype(np.float32)
    empty = _empty()
    scene = replace(empty, points=np.concatenate((empty.points, wall)))
    for seed in range(20):
        found = pasted(scene, database, np.array((25.0, 0.0)), 6.0, SAME_RANGE, 5, np.random.default_rng(seed))
        assert not len(found.boxes) and np.array_equal(found.points, scene.points)


def test_no_vehicle_at_such_a_range_means_none(database: VehicleDatabase) -> None:
    scene = pasted(_empty(), database, np.array((3.0, 0.0)), 1.0, SAME_RANGE, 5, np.random.default_rng(0))
    assert not len(scene.boxes)


def test_a_long_vehicle_is_put_on_nothing_that_stands_at_its_ends(tmp_path: Path) -> None:
    truck = np.array((30.0, 0.0, 1.5, 9.0, 2.5, 3.0, 0.0), dtype=np.float32)
    rng = np.random.default_rng(0)
    files = cache_scenes(tmp_path, ["0"], lambda _: TrainingScene(_on(truck, rng), truck[None], HEIGHT_M))
    trucks, empty = VehicleDatabase.of(files, 5), _empty()
    pole = np.column_stack((np.full(200, 4.0), np.zeros(200), np.linspace(0.5, 2.5, 200))).astype(np.float32)
    put, farther = 0, Augmentation(pasted=4, pasted_range=(1.0, 1.3))
    for seed in range(40):
        free = pasted(empty, trucks, np.array((33.0, 0.0)), 2.0, farther, 5, np.random.default_rng(seed))
        for box in free.boxes[:1]:
            cos, sin = np.cos(box[6]), np.sin(box[6])
            at_end = pole @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]], dtype=np.float32)
            at_end[:, :2] += box[:2]
            scene = replace(empty, points=np.concatenate((empty.points, at_end)))
            again = pasted(scene, trucks, np.array((33.0, 0.0)), 2.0, farther, 5, np.random.default_rng(seed))
            assert not points_in_boxes(at_end, again.boxes, 0.0).any()
            put += 1
    assert put
