"""KITTI frames: conventions by hand-computed cases, real frames if present, bad files refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.scenes.ground_map import estimate_ground_z
from shift3d.scenes.kitti.files import Calibration, lidar_box, read_labels
from shift3d.scenes.kitti.scenes import KittiScenes

# Camera x = -lidar y, camera y = -lidar z, camera z = lidar x, no offset: only the axes of the two frames differ.
AXES = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
PROJECTION = np.array([[700.0, 0.0, 600.0, 0.0], [0.0, 700.0, 180.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
CAMERA = Calibration(PROJECTION, AXES)


def test_camera_box_to_lidar_box_by_hand() -> None:
    """The car is 20 m ahead, 3 m to the right, 1.7 m below the camera, 1.5 m high, nose to the right."""
    box = lidar_box([1.5, 1.6, 4.0], [3.0, 1.7, 20.0], 0.0, CAMERA)
    np.testing.assert_allclose(box, [20.0, -3.0, -1.7 + 0.75, 4.0, 1.6, 1.5, -np.pi / 2], atol=1e-12)


@pytest.mark.parametrize(("rotation_y", "heading"), [(-np.pi / 2, 0.0), (np.pi / 2, np.pi), (np.pi, np.pi / 2)])
def test_rotation_y_to_heading(rotation_y: float, heading: float) -> None:
    box = lidar_box([1.5, 1.6, 4.0], [0.0, 1.7, 20.0], rotation_y, CAMERA)
    assert np.cos(box[6] - heading) == pytest.approx(1.0)


def test_lidar_offset_is_undone() -> None:
    moved = AXES.copy()
    moved[:3, 3] = [0.1, -0.2, -0.3]
    box = lidar_box([1.5, 1.6, 4.0], [0.1, 1.7 - 0.2, 20.0 - 0.3], -np.pi / 2, Calibration(PROJECTION, moved))
    np.testing.assert_allclose(box[:3], [20.0, 0.0, -0.95], atol=1e-12)


def write_frame(folder: Path, name: str, points: np.ndarray, label: str | None = "") -> Path:
    for part in ("velodyne", "calib", "label_2"):
        (folder / "training" / part).mkdir(parents=True, exist_ok=True)
    points.astype("<f4").tofile(folder / "training" / "velodyne" / f"{name}.bin")
    lines = {"P2": PROJECTION, "R0_rect": np.eye(3), "Tr_velo_to_cam": AXES[:3]}
    text = "".join(f"{key}: {' '.join(f'{v:.6e}' for v in m.ravel())}\n" for key, m in lines.items())
    (folder / "training" / "calib" / f"{name}.txt").write_text(text)
    if label is not None:
        (folder / "training" / "label_2" / f"{name}.txt").write_text(label)
    return folder


CAR = "Car 0.00 0 0.0 500 150 600 200 1.50 1.60 4.00 0.00 1.70 20.00 -1.570796"
POINTS = np.array([[20.0, 0.5, -1.0, 0.3], [19.0, -0.5, -0.8, 0.4], [20.0, 5.0, -1.7, 0.2], [0.0, 0.0, 0.0, 0.0]])


def test_a_frame_is_read_in_file_order(tmp_path: Path) -> None:
    dont_care = "DontCare -1 -1 -10 0 0 10 10 -1 -1 -1 -1000 -1000 -1000 -10"
    root = write_frame(tmp_path, "000007", POINTS, f"{CAR}\n{dont_care}\n")
    for given in (root, root / "training", str(root)):
        scenes = KittiScenes(given)
        assert scenes.names() == ["000007"]
        scene = scenes.load("000007")
        np.testing.assert_array_equal(scene.points, POINTS[:, :3].astype(np.float32))
        assert scene.labels.classes == ("vehicle",)
        assert scene.labels.names == ("Car",)
        assert scene.labels.num_points.tolist() == [2]
        assert scene.has_beam.tolist() == [True, True, True, False]
        assert scene.ground_z_m == -1.73


def test_the_camera_sees_ahead_only(tmp_path: Path) -> None:
    view = KittiScenes(write_frame(tmp_path, "000007", POINTS)).camera_view("000007")
    points = np.array([[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0], [10.0, 9.0, 0.0], [10.0, 8.0, 0.0], [10.0, 0.0, 5.0]])
    boxes = np.concatenate((points, np.ones((5, 4))), axis=1)
    assert view.in_view(boxes).tolist() == [True, False, False, True, True]


def test_ground_height_is_found_in_the_fullest_layer() -> None:
    rng = np.random.default_rng(0)
    ring = rng.uniform(-np.pi, np.pi, 4000)
    ground = np.stack((8 * np.cos(ring), 8 * np.sin(ring), rng.normal(-1.66, 0.02, 4000)), axis=1)
    clutter = np.stack((6 * np.cos(ring), 6 * np.sin(ring), rng.uniform(-1.6, 1.0, 4000)), axis=1)
    found = estimate_ground_z(np.concatenate((ground, clutter)).astype(np.float32), -1.73)
    assert found == pytest.approx(-1.66, abs=0.021)


@pytest.mark.parametrize("ground_z_m", [-0.6, -1.1, -1.55, -1.9, -2.1, -2.4, -3.4])
def test_the_ground_of_a_frame_is_found_at_any_mounting_height(tmp_path: Path, ground_z_m: float) -> None:
    rng = np.random.default_rng(0)
    ring, reach = rng.uniform(-np.pi, np.pi, 4000), rng.uniform(4.0, 30.0, 4000)
    z = np.where(rng.random(4000) < 0.8, rng.normal(ground_z_m, 0.02, 4000), rng.uniform(ground_z_m, 1.0, 4000))
    points = np.stack((reach * np.cos(ring), reach * np.sin(ring), z, np.full(4000, 0.3)), axis=1)
    scene = KittiScenes(write_frame(tmp_path, "000007", points)).load("000007")
    assert scene.ground_z_m == pytest.approx(ground_z_m, abs=0.011)


def scaled(factor: float) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        write_frame(root, "000007", POINTS * (factor, factor, factor, 1.0), CAR)

    return change


def truncate(root: Path) -> None:
    path = root / "training" / "velodyne" / "000007.bin"
    path.write_bytes(path.read_bytes()[:-3])


def poison(root: Path) -> None:
    points = POINTS.copy()
    points[2, 1] = np.nan
    write_frame(root, "000007", points)


def drop_frame(root: Path) -> None:
    (root / "training" / "velodyne" / "000007.bin").unlink()


def replace_in(part: str, old: str, new: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = root / "training" / part / "000007.txt"
        path.write_text(path.read_text().replace(old, new))

    return change


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (truncate, r"velodyne.000007\.bin.*61 bytes.*truncated"),
        (poison, r"velodyne.000007\.bin.*row 2"),
        (scaled(100.0), r"velodyne.000007\.bin: the median range is .*metres"),
        (scaled(0.001), r"velodyne.000007\.bin: the median range is .*metres"),
        (drop_frame, r"label_2.000007\.txt.*no frame"),
        (replace_in("label_2", "1.60", "wide"), r"label_2.000007\.txt, line 1.*'wide'"),
        (replace_in("label_2", "1.60", "-1.60"), r"line 1.*size"),
        (replace_in("label_2", CAR.split()[14], "90"), r"line 1.*rotation_y 90, over two turns.*radians"),
        (replace_in("label_2", "Car", "Carr"), r"line 1.*unknown class 'Carr'"),
        (replace_in("label_2", " 20.00", ""), r"line 1.*14 columns"),
        (replace_in("calib", "Tr_velo_to_cam", "Tr_imu"), r"calib.000007\.txt.*Tr_velo_to_cam"),
        (replace_in("calib", "7.000000e+02", "x"), r"calib.000007\.txt, line 1.*'x'"),
        (lambda root: (root / "training" / "calib" / "000007.txt").unlink(), r"calib.000007\.txt.*is missing"),
        (lambda root: (root / "training" / "label_2" / "000007.txt").unlink(), r"label_2.000007\.txt.*is missing"),
    ],
)
def test_bad_files_give_one_clear_line(tmp_path: Path, spoil: Callable[[Path], None], says: str) -> None:
    root = write_frame(tmp_path, "000007", POINTS, CAR)
    write_frame(tmp_path, "000008", POINTS, CAR)
    spoil(root)
    with pytest.raises(InputError, match=says) as caught:
        KittiScenes(root).load("000007")
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_missing_root_and_unknown_names(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.*training"):
        KittiScenes(tmp_path / "nowhere")
    root = write_frame(tmp_path, "000007", POINTS, CAR)
    with pytest.raises(InputError, match=r"000009.*000007"):
        KittiScenes(root, names=["000009"])
    with pytest.raises(InputError, match=r"000009"):
        KittiScenes(root).load("000009")


def test_a_label_row_without_a_box_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "label.txt"
    path.write_text("\nDontCare -1 -1 -10 0 0 1 1 -1 -1 -1 -1000 -1000 -1000 -10\n")
    assert read_labels(path, CAMERA) == []


def test_real_frames_load(real_data: Callable[[str], Path]) -> None:
    root = real_data("kitti")
    scenes = KittiScenes(root)
    assert len(scenes.names()) >= 10
    for name in scenes.names():
        scene = scenes.load(name)
        assert len(scene.points) > 100_000
        assert -1.85 < scene.ground_z_m < -1.6
        assert scene.ground_z_m == estimate_ground_z(scene.points, -1.73)


def test_real_beams_turn_counter_clockwise_ring_by_ring_downwards(real_data: Callable[[str], Path]) -> None:
    """Ranges from the origin are the file's; azimuths are in the order of 64 turns, each below the one before."""
    root = real_data("kitti")
    for name in KittiScenes(root).names()[:3]:
        scene = KittiScenes(root).load(name)
        raw = np.fromfile(root / "training" / "velodyne" / f"{name}.bin", "<f4").reshape(-1, 4)
        away = scene.points.astype(np.float64) - scene.origins
        reach = np.linalg.norm(away, axis=1)
        np.testing.assert_allclose(reach, np.linalg.norm(raw[:, :3].astype(np.float64), axis=1), atol=1e-6)
        azimuth, up = np.arctan2(away[:, 1], away[:, 0]), np.arcsin(away[:, 2] / reach)
        step = np.mod(np.diff(azimuth) + np.pi, 2 * np.pi) - np.pi
        assert (step > 0).mean() > 0.999
        turn = np.floor((np.cumsum(np.concatenate(([0.0], step))) + azimuth[0]) / (2 * np.pi)).astype(int)
        rings = [np.median(up[turn == number]) for number in np.unique(turn)]
        assert len(rings) == 64 and (np.diff(rings) < 0).all()


def test_labelled_boxes_hold_their_points_and_stand_on_the_ground(real_data: Callable[[str], Path]) -> None:
    root = real_data("kitti")
    scene = KittiScenes(root).load("001584")
    near = scene.labels.num_points > 300
    assert near.sum() == 3
    for car, count in zip(scene.labels.boxes[near], scene.labels.num_points[near], strict=True):
        assert points_in_boxes(scene.points, car[None]).sum() == count
        # A wrong heading or centre would cut off the car's points; a box 30 cm larger holds hardly more.
        above = scene.points[scene.points[:, 2] > car[2] - car[5] / 2 + 0.3]
        larger = points_in_boxes(above, car[None], margin_m=0.3).sum()
        assert points_in_boxes(above, car[None]).sum() > 0.94 * larger
        assert abs(car[2] - car[5] / 2 - scene.ground_z_m) < 0.3


def test_labelled_boxes_are_in_the_cameras_view(real_data: Callable[[str], Path]) -> None:
    root = real_data("kitti")
    scenes = KittiScenes(root)
    scene = scenes.load("000038")
    assert scenes.camera_view("000038").in_view(scene.labels.boxes).all()
    bearing = np.arctan2(scene.labels.boxes[:, 1], scene.labels.boxes[:, 0])
    assert (np.abs(bearing) < 0.75).all()


@pytest.mark.parametrize(("reflectance_max", "factor"), [(None, 1.0), (255.0, 255.0), (65535.0, 65535.0)])
def test_reflectance_is_brought_to_one_scale(tmp_path: Path, reflectance_max: float | None, factor: float) -> None:
    root = write_frame(tmp_path, "000007", POINTS * (1.0, 1.0, 1.0, factor), CAR)
    scene = KittiScenes(root, reflectance_max=reflectance_max).load("000007")
    assert scene.reflectance is not None
    np.testing.assert_allclose(scene.reflectance, POINTS[:, 3], rtol=1e-6)


def test_reflectance_on_another_scale_names_file_row_and_remedy(tmp_path: Path) -> None:
    root = write_frame(tmp_path, "000007", POINTS * (1.0, 1.0, 1.0, 255.0), CAR)
    with pytest.raises(InputError, match=r"velodyne.000007\.bin: row 0 has reflectance 76\.5.*0 to 1 ") as caught:
        KittiScenes(root).load("000007")
    assert "scenes.reflectance_max" in caught.value.remedy
