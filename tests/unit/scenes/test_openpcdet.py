"""OpenPCDet's custom layout: frames, labels, the sensor's place, and damaged files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.scenes.argoverse2 import log as argoverse2
from shift3d.scenes.description import describe_scene
from shift3d.scenes.kitti import files as kitti
from shift3d.scenes.nuscenes.tables import class_of as nuscenes_class_of
from shift3d.scenes.openpcdet import OpenPcdetScenes, class_of
from shift3d.scenes.waymo import frame as waymo

LABELS = "12.0 3.0 -0.9 4.5 1.9 1.6 0.3 Car\n8.0 -5.0 -0.8 0.7 0.7 1.8 0.0 Pedestrian\n9 9 -1 1 1 1 0 Bollard\n"


def frame(ground_z_m: float = -1.7, seed: int = 0) -> np.ndarray:
    """Return ground and some clutter, (N, 4) float32."""
    rng = np.random.default_rng(seed)
    reach, turn = rng.uniform(3.0, 40.0, 6000), rng.uniform(-np.pi, np.pi, 6000)
    z = np.where(rng.random(6000) < 0.8, ground_z_m + rng.normal(0, 0.02, 6000), rng.uniform(ground_z_m, 2.0, 6000))
    return np.stack((reach * np.cos(turn), reach * np.sin(turn), z, rng.random(6000)), axis=1).astype(np.float32)


def write(root: Path, points: np.ndarray | None = None, labels: str | None = LABELS) -> Path:
    for part in ("points", "labels", "ImageSets"):
        (root / part).mkdir(parents=True, exist_ok=True)
    for name in ("000000", "000001", "000002"):
        np.save(root / "points" / f"{name}.npy", frame() if points is None else points)
        if labels is not None:
            (root / "labels" / f"{name}.txt").write_text(labels)
    (root / "ImageSets" / "val.txt").write_text("000002\n000001\n\n")
    return root


def test_a_frame_is_read_in_file_order(tmp_path: Path) -> None:
    scene = OpenPcdetScenes(write(tmp_path)).load("000001")
    np.testing.assert_array_equal(scene.points, frame()[:, :3])
    np.testing.assert_allclose(scene.reflectance, frame()[:, 3])
    np.testing.assert_allclose(scene.labels.boxes[0], [12.0, 3.0, -0.9, 4.5, 1.9, 1.6, 0.3])
    assert scene.labels.classes == ("vehicle", "pedestrian", "other")
    assert scene.labels.names == ("Car", "Pedestrian", "Bollard")
    assert scene.ground_z_m == pytest.approx(-1.7, abs=0.011)


@pytest.mark.parametrize("sensor_m", [(0.0, 0.0, 0.0), (0.0, 0.0, 1.9)])
def test_rows_of_zeros_are_beams_without_a_return(tmp_path: Path, sensor_m: tuple[float, float, float]) -> None:
    """Organised clouds have such rows; this cloud has more of them than of returns."""
    moved = frame()
    moved[:, :3] += sensor_m
    cloud = np.concatenate((np.zeros((8000, 4), np.float32), moved))
    scene = OpenPcdetScenes(write(tmp_path, cloud), sensor_m=sensor_m).load("000001")
    assert scene.has_beam.sum() == len(moved) and not scene.has_beam[:8000].any()
    assert scene.ground_z_m == pytest.approx(-1.7, abs=0.011)
    nothing = OpenPcdetScenes(write(tmp_path, np.zeros((9, 4), np.float32)), ground_z_m=-1.0)
    with pytest.raises(InputError, match="no point with a positive range"):
        nothing.load("000001")


def test_a_sensor_away_from_the_origin_becomes_the_origin(tmp_path: Path) -> None:
    """The frame is the same, as seen from the ground below the vehicle's rear axle."""
    sensor = (1.2, 0.1, 1.9)
    moved = frame()
    moved[:, :3] += sensor
    scene = OpenPcdetScenes(write(tmp_path, moved), sensor_m=sensor).load("000001")
    np.testing.assert_allclose(scene.points, frame()[:, :3], atol=1e-5)
    np.testing.assert_allclose(scene.labels.boxes[0, :3], np.array([12.0, 3.0, -0.9]) - sensor)
    assert scene.ground_z_m == pytest.approx(-1.7, abs=0.011)
    stated = OpenPcdetScenes(tmp_path, sensor_m=sensor, ground_z_m=0.2).load("000001")
    assert stated.ground_z_m == pytest.approx(-1.7)


@pytest.mark.parametrize(("ground_z_m", "height_m"), [(1.1, 0.0), (0.0, 0.0), (1.9, 1.9)])
def test_a_ground_that_is_not_below_the_sensor_is_refused(tmp_path: Path, ground_z_m: float, height_m: float) -> None:
    """Typical mistake: the sensor's height above the ground in place of the ground's height in the frame."""
    with pytest.raises(InputError, match=r"scenes\.ground_z_m: .* not below the LiDAR .*negative"):
        OpenPcdetScenes(write(tmp_path), sensor_m=(0.0, 0.0, height_m), ground_z_m=ground_z_m)


@pytest.mark.parametrize("ground_z_m", [-0.6, -1.2, -2.1, -3.4])
def test_the_ground_is_found_at_any_mounting_height(tmp_path: Path, ground_z_m: float) -> None:
    scene = OpenPcdetScenes(write(tmp_path, frame(ground_z_m))).load("000000")
    assert scene.ground_z_m == pytest.approx(ground_z_m, abs=0.011)


def test_reflectance_of_0_to_255_is_recognised_or_stated(tmp_path: Path) -> None:
    points = frame()
    points[:, 3] = np.round(points[:, 3] * 255)
    for stated in (None, 255.0):
        scene = OpenPcdetScenes(write(tmp_path, points), reflectance_max=stated).load("000000")
        np.testing.assert_allclose(scene.reflectance, points[:, 3] / 255, rtol=1e-6)
    assert OpenPcdetScenes(write(tmp_path, frame()[:, :3])).load("000000").reflectance is None


def test_frames_are_chosen(tmp_path: Path) -> None:
    write(tmp_path)
    assert OpenPcdetScenes(tmp_path).names() == ["000000", "000001", "000002"]
    assert OpenPcdetScenes(tmp_path, split="val").names() == ["000002", "000001"]
    assert OpenPcdetScenes(tmp_path, split="val", count=1).names() == ["000002"]
    assert OpenPcdetScenes(tmp_path, names=["000001"]).names() == ["000001"]
    assert OpenPcdetScenes(tmp_path, names=["000002", "000002", "000001"], count=2).names() == ["000002", "000001"]
    with pytest.raises(InputError, match=r"points: no scenes\. Name some in scenes\.names"):
        OpenPcdetScenes(tmp_path, names=[])
    (tmp_path / "points" / "000001.npy").unlink()
    assert OpenPcdetScenes(tmp_path, split="val", list_unreadable=True).names() == ["000002", "000001"]
    named = OpenPcdetScenes(tmp_path, names=["000001", "000009"], list_unreadable=True)
    assert named.names() == ["000001", "000009"], "a wrong one is reported when it is loaded"
    with pytest.raises(InputError, match=r"val\.txt: no frame points/000001\.npy"):
        OpenPcdetScenes(tmp_path, split="val")
    with pytest.raises(InputError, match=r"train\.txt: the list of frames is missing"):
        OpenPcdetScenes(tmp_path, split="train")
    with pytest.raises(InputError, match="no folder points/"):
        OpenPcdetScenes(tmp_path / "points")


def test_the_description_shows_swapped_columns_and_boxes_that_are_given_by_their_bottoms(tmp_path: Path) -> None:
    """Medians over the vehicles alone; the boxes of two labels differ by 20 cm in each size."""
    labels = "12 3 -1.7 1.9 4.5 1.6 0 Car\n-9 3 -1.8 2.1 4.7 1.8 0 Van\n9 9 5 1 1 1 0 Pedestrian\n"
    scene = OpenPcdetScenes(write(tmp_path, labels=labels), ground_z_m=-1.7).load("000001")
    line = next(line for line in describe_scene(scene) if line.startswith("vehicles:"))
    assert line.endswith("2.00 m long, 4.60 m wide, 1.70 m high, bottom 0.90 m below the ground")
    without = OpenPcdetScenes(write(tmp_path, labels=""), ground_z_m=-1.7).load("000001")
    assert not any("vehicles" in line for line in describe_scene(without))


def test_names_of_classes() -> None:
    assert [class_of(name) for name in ("Car", "TRUCK", "Vehicle", "person", "Cyclist", "cone")] == [
        "vehicle", "vehicle", "vehicle", "pedestrian", "cyclist", "other",
    ]  # fmt: skip


@pytest.mark.parametrize("written", [str, str.lower, str.title, lambda name: re.sub(r"[_.]", "-", name),
                                     lambda name: re.sub(r"[_.]", "", name)])  # fmt: skip
def test_names_of_other_data_sets_are_known(written: Callable[[str], str]) -> None:
    known = {**kitti.CLASSES, **argoverse2.CLASSES, **dict(waymo.CLASSES.values())}
    known |= dict.fromkeys(("SUV", "motor_vehicle", "pickup_truck"), "vehicle")
    nuscenes = ("vehicle.bus.rigid", "vehicle.emergency.police", "vehicle.bicycle", "human.pedestrian.adult", "animal")
    known |= {name: nuscenes_class_of(name) for name in nuscenes}
    for cycle in ("BICYCLE", "MOTORCYCLE"):  # with or without a rider, as nuScenes has them
        known[cycle] = "cyclist"
    assert {name: class_of(written(name)) for name in known} == known


def label(text: str) -> Callable[[Path], object]:
    return lambda root: (root / "labels" / "000001.txt").write_text(text)


def points(values: np.ndarray) -> Callable[[Path], object]:
    return lambda root: np.save(root / "points" / "000001.npy", values)


def unclosed(root: Path) -> None:
    """Damage the brace that closes the header of an array."""
    file = root / "points" / "000001.npy"
    file.write_bytes(file.read_bytes().replace(b"}", b"|", 1))


def with_nan() -> np.ndarray:
    values = frame()
    values[7, 1] = np.nan
    return values


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda root: (root / "points" / "000001.npy").write_bytes(b"\x93NUMPY\x01"), r"not a readable \.npy"),
        (lambda root: (root / "points" / "000001.npy").write_bytes(b""), r"not a readable \.npy"),
        (unclosed, r"points/000001\.npy: not a readable \.npy"),
        (lambda root: (root / "labels" / "000001.txt").unlink(), r"label file is missing.*labels/ away"),
        (points(frame()[:0]), r"no point with a positive range"),
        (points(frame()[:, :2]), r"not rows of x, y, z"),
        (points(np.array([["a", "b", "c"]])), r"not an array of numbers"),
        (points(np.array([[{}, 1, 2]], dtype=object)), r"not a readable \.npy"),
        (points(with_nan()), r"with NaN or infinity, first is row 7"),
        (points(frame() * (1000, 1000, 1000, 1)), r"range of .*metres"),
        (points(frame() * (1, 1, 1, 9000)), r"scenes\.reflectance_max"),
        (points(frame() + np.float32((0, 0, 40, 0))), r"scenes\.ground_z_m"),
        (label("1 2 3 4 5 6 Car"), r"line 1: 7 columns, 8 expected"),
        (label("1 2 3 4 5 6 x Car"), r"line 1: a column that is no number"),
        (label("1 2 3 4 0 6 0 Car"), r"line 1: a box of"),
        (label("1 2 nan 4 5 6 0 Car"), r"line 1: a box of"),
        (label("1 2 3 4 5 6 95 Car"), r"line 1: a heading of 95 rad.*radians"),
        (label("1 2 3 4e200 5 6 0 Car"), r"000001\.txt: box 0 has place and size .*metres"),
        (label("1 -2e300 3 4 5 6 0 Car"), r"000001\.txt: box 0 has place and size .*metres"),
    ],
)
def test_damaged_files_give_one_clear_line(tmp_path: Path, spoil: Callable[[Path], object], says: str) -> None:
    spoil(write(tmp_path))
    with pytest.raises(InputError, match=says) as caught:
        OpenPcdetScenes(tmp_path).load("000001")
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_a_heading_of_more_than_one_turn_is_read(tmp_path: Path) -> None:
    root = write(tmp_path)
    label("1 2 3 4 5 6 -6.5 Car")(root)
    assert OpenPcdetScenes(root).load("000001").labels.boxes[0, 6] == -6.5


@pytest.mark.parametrize("name", ["a.bin", "a.pcd", "a.npz"])
def test_points_in_another_format_are_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "points").mkdir()
    (tmp_path / "points" / name).write_bytes(b"")
    with pytest.raises(InputError, match=rf"points: no \.npy file among {name}\. .*np\.save"):
        OpenPcdetScenes(tmp_path)


def test_a_split_without_its_list_says_which_setting_asks_for_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"test\.txt: the list of frames is missing.*scenes\.split"):
        OpenPcdetScenes(write(tmp_path), split="test")


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for root in (tmp_path / "file", tmp_path / "absent"):
        with pytest.raises(InputError, match="points"):
            OpenPcdetScenes(root)
