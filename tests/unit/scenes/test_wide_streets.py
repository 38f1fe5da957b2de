"""Streets with vehicles of the wide family: labelled by kind, seen or held out as requested; the rest is unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.geometry.iou import iou_bev
from shift3d.scenes.scene import Labels, Scene
from shift3d.scenes.sets import StreetScenes
from shift3d.scenes.street.assemble import street_scene
from shift3d.scenes.street.build.fleet import fleet_of
from shift3d.scenes.street.options import StreetOptions
from shift3d.vehicles.family.split import SPLIT


def street(traffic: str, split: str = "test", index: int = 3) -> Scene:
    return street_scene(split, 0, index, "hdl64", StreetOptions(traffic=traffic))


@pytest.fixture(scope="module")
def held_out() -> list[Scene]:
    return [street("held_out", index=index) for index in range(2)]


def test_training_streets_have_seen_kinds_alone() -> None:
    scene = street("wide", "train")
    scene.validate()
    kinds = [kind for kind, name in zip(scene.labels.kinds, scene.labels.classes) if name == "vehicle"]
    assert len(kinds) >= 5 and all(set(kind.split("+")) <= set(SPLIT.seen) for kind in kinds)
    assert all(not kind for kind, name in zip(scene.labels.kinds, scene.labels.classes) if name != "vehicle")
    assert scene.scene_id == "street-train-hdl64-000003-wide" and scene.dataset == "street-hdl64-wide"


def test_about_half_of_the_vehicles_are_held_out_where_that_is_asked(held_out: list[Scene]) -> None:
    kinds = [kind for scene in held_out for kind in scene.labels.kinds if kind]
    share = np.mean([not set(kind.split("+")) <= set(SPLIT.seen) for kind in kinds])
    assert len(kinds) > 20 and 0.25 < share < 0.75
    assert len({name for kind in kinds for name in kind.split("+")} & set(SPLIT.held_out)) >= 5


def test_boxes_stand_apart_and_hold_their_vehicles(held_out: list[Scene]) -> None:
    for scene in held_out:
        scene.validate()
        boxes = scene.labels.of_class("vehicle")
        assert (iou_bev(boxes, boxes) - np.eye(len(boxes))).max() < 1e-6
        inside = points_in_boxes(scene.points, scene.labels.boxes).sum(axis=1)
        np.testing.assert_array_equal(scene.labels.num_points, inside)


@pytest.mark.parametrize("held_out", [False, True])
def test_vehicles_are_of_the_size_that_their_slot_has_and_no_larger(held_out: bool) -> None:
    fleet = fleet_of("held_out" if held_out else "wide", "val")
    for variant in range(12):
        vehicle, size = fleet.vehicle(variant), np.array(fleet.slot_m(variant))
        assert vehicle.size_m == pytest.approx(size)
        assert vehicle.radius_m - 0.011 <= np.linalg.norm(size) / 2
        # From ahead, the left and above, at most onto the middle of each face's plane.
        for axis in range(3):
            start = np.zeros((1, 3), np.float32)
            start[0, axis] = 20.0
            hit_m, _, _ = vehicle.intersector.first_hit(start, -np.sign(start).astype(np.float32))
            assert hit_m[0] >= 20.0 - size[axis] / 2 - 1e-3
        low, high = vehicle.glass_band_m
        assert -size[2] / 2 < low < high < size[2] / 2 or low == high


def test_no_two_vehicles_of_training_are_alike() -> None:
    sizes = {fleet_of("wide", "train").slot_m(variant) for variant in range(1000)}
    assert len(sizes) == 1000
    assert not sizes & {fleet_of("wide", "test").slot_m(variant) for variant in range(200)}


def test_the_same_name_gives_the_same_bytes_and_kinds_are_part_of_them(held_out: list[Scene]) -> None:
    scenes = StreetScenes("hdl64", options=StreetOptions(traffic="held_out"))
    assert scenes.names() == ["street-test-hdl64-000000-held_out"]
    again = scenes.load(scenes.names()[0])
    assert again.scene_id == scenes.names()[0] and again.content_hash() == held_out[0].content_hash()
    renamed = replace(again, labels=replace(again.labels, kinds=("van",) * len(again.labels.kinds)))
    assert renamed.content_hash() != again.content_hash()


def test_other_streets_have_no_kinds() -> None:
    assert street("family").labels.kinds == ()


def test_held_out_kinds_are_refused_on_streets_to_train_on() -> None:
    with pytest.raises(InputError, match="split=train"):
        StreetScenes("hdl64", split="train", options=StreetOptions(traffic="held_out"))
    with pytest.raises(InputError, match="split=train"):
        street("held_out", "train")
    with pytest.raises(InputError, match="unknown traffic"):
        StreetOptions(traffic="rush hour")


def test_a_set_names_its_seed() -> None:
    scenes = StreetScenes("hdl64", seed=2, options=StreetOptions(traffic="held_out"))
    assert scenes.names() == ["street-test-hdl64-000000-held_out-seed2"]


def test_kinds_are_one_a_box() -> None:
    labels = Labels(np.zeros((0, 7)), (), np.zeros(0, np.int32), kinds=("sedan",))
    with pytest.raises(InputError, match="kinds"):
        labels.validate("scene")
