"""Street scenes: the same bytes for the same name, labels that fit the points, and realistic sensors."""

from __future__ import annotations

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.geometry.iou import iou_bev
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import StreetScenes
from shift3d.scenes.street.assemble import street_scene
from shift3d.scenes.street.build.fleet import fleet_of
from shift3d.scenes.street.build.layout import LEAST_VEHICLES, MOST_VEHICLES, sample_layout
from shift3d.scenes.street.build.pool import POOL_SIZES, pool_vehicle
from shift3d.scenes.street.sensors import SENSORS
from shift3d.seeding import generator


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    mixed = StreetScenes("mixed", count=4)
    return [mixed.load(name) for name in mixed.names()]


@pytest.mark.parametrize(("index", "sensor"), list(enumerate(SENSORS)))
def test_the_same_name_gives_the_same_bytes(scenes: list[Scene], index: int, sensor: str) -> None:
    first, again = scenes[index], street_scene("test", 0, index, sensor)
    assert first.scene_id == again.scene_id and first.points.tobytes() == again.points.tobytes()
    assert first.content_hash() == again.content_hash()


def test_seed_index_split_and_sensor_all_matter(scenes: list[Scene]) -> None:
    others = (("test", 1, 0, "hdl64"), ("val", 0, 0, "hdl64"), ("test", 0, 0, "waymo_top"))
    points = [scenes[0].points, scenes[2].points, *(street_scene(*arguments).points for arguments in others)]
    assert len({one.tobytes() for one in points}) == 5


def test_scenes_are_valid_and_name_their_parts(scenes: list[Scene]) -> None:
    for scene in scenes:
        scene.validate()
        assert scene.scene_id.startswith("street-test-")
        assert 60_000 < len(scene.points) < 180_000
        assert scene.origins.strides[0] == 0


def test_labels_count_the_points_in_their_boxes(scenes: list[Scene]) -> None:
    for scene in scenes:
        inside = points_in_boxes(scene.points, scene.labels.boxes).sum(axis=1)
        np.testing.assert_array_equal(scene.labels.num_points, inside)
        assert (scene.labels.num_points > 0).all()


def test_boxes_are_tight(scenes: list[Scene]) -> None:
    """Hardly any point of a vehicle is just outside its box, above the ground and below the roof's height."""
    for scene in scenes:
        boxes = scene.labels.of_class("vehicle")
        cores, shells = boxes.copy(), boxes.copy()
        cores[:, 2] += 0.1
        cores[:, 5] -= 0.5
        shells[:, 2] += 0.1
        shells[:, 5] -= 0.5
        shells[:, 3:5] += 0.24
        inside = points_in_boxes(scene.points, cores, margin_m=0.04).any(axis=0)
        around = points_in_boxes(scene.points, shells).any(axis=0)
        assert inside.sum() > 0.97 * around.sum()


def test_vehicles_do_not_run_into_each_other(scenes: list[Scene]) -> None:
    for scene in scenes:
        boxes = scene.labels.of_class("vehicle")
        overlap = iou_bev(boxes, boxes) - np.eye(len(boxes))
        assert overlap.max() < 0.01


def test_vehicles_stand_on_the_ground(scenes: list[Scene]) -> None:
    for scene in scenes:
        for box in scene.labels.of_class("vehicle"):
            near = scene.points[np.hypot(*(scene.points[:, :2] - box[:2]).T) < 4.0]
            if len(near) < 200:
                continue
            assert abs(np.percentile(near[:, 2], 2) - (box[2] - box[5] / 2)) < 0.5


def test_points_lie_on_the_beams_they_name(scenes: list[Scene]) -> None:
    for scene in scenes:
        sensor = SENSORS[scene.dataset.removeprefix("street-")]
        assert scene.range_image_index is not None and scene.time_s is not None
        row, column = scene.range_image_index.T
        range_m = np.linalg.norm(scene.points, axis=1)
        elevation = np.arcsin(scene.points[:, 2] / range_m)
        np.testing.assert_allclose(elevation, np.asarray(sensor.elevations_rad)[row], atol=1e-5)
        azimuth = np.arctan2(scene.points[:, 1], scene.points[:, 0])
        np.testing.assert_allclose(azimuth, sensor.azimuths_rad()[column], atol=1e-5)
        assert range_m.max() <= sensor.max_range_m + 1e-3
        assert len(np.unique(row * sensor.columns + column)) == len(row)
        assert scene.time_s.min() >= 0.0 and scene.time_s.max() < sensor.turn_s


def test_every_layout_has_the_vehicles_a_detector_needs() -> None:
    headings = []
    for index in range(60):
        layout = sample_layout(generator("layout-test", index), 1.73, fleet_of("family", "test"))
        near = [item for item in layout.items if item.kind == "vehicle" and np.hypot(item.x, item.y) < 75.0]
        assert LEAST_VEHICLES <= len(near) <= MOST_VEHICLES + 5
        headings += [item.heading_rad for item in near]
    shares, _ = np.histogram(np.mod(headings, 2 * np.pi), bins=12, range=(0.0, 2 * np.pi))
    assert shares.min() > 0.02 * len(headings)


@pytest.mark.parametrize("height_m", [1.73, 2.18])
def test_the_ground_under_the_sensor_is_at_its_mount_height(height_m: float) -> None:
    for index in range(5):
        ground = sample_layout(generator("ground-test", index), height_m, fleet_of("family", "test")).ground
        assert float(ground.height(np.zeros(()), np.zeros(()))) == pytest.approx(-height_m)
        vertices, faces, material = ground.mesh()
        np.testing.assert_allclose(vertices[:, 2], ground.height(vertices[:, 0], vertices[:, 1]))
        assert len(faces) == len(material)


def test_splits_share_no_vehicle() -> None:
    sizes = {split: {tuple(pool_vehicle(split, i).size_m) for i in range(5)} for split in POOL_SIZES}
    assert not sizes["train"] & sizes["test"]
    assert not sizes["train"] & sizes["val"]
    assert not sizes["val"] & sizes["test"]


def test_set_names_and_unknown_names() -> None:
    scenes = StreetScenes("mixed", seed=2, count=2, split="train", start=6)
    assert scenes.names() == ["street-train-hdl64-000006-seed2", "street-train-waymo_top-000007-seed2"]
    assert StreetScenes("hdl64", count=8).names()[7] == "street-test-hdl64-000007"
    with pytest.raises(InputError, match="street-train-hdl64-000005"):
        scenes.load("street-train-hdl64-000005")
    with pytest.raises(InputError, match="unknown sensor 'vlp16'"):
        StreetScenes("vlp16")
    with pytest.raises(InputError, match="unknown split 'dev'"):
        StreetScenes(split="dev")
    with pytest.raises(InputError, match="count=0"):
        StreetScenes(count=0)
    with pytest.raises(InputError, match=r"unknown sensor 'mixed'\. Choose from hdl64, waymo_top"):
        street_scene("test", 0, 0, "mixed")
    with pytest.raises(InputError, match="unknown split 'dev'"):
        street_scene("dev", 0, 0, "hdl64")
