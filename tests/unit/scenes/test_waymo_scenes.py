"""Waymo v2: a segment in its schema is read back pixel by pixel, and inconsistent components are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from waymo_segment import (
    BOX,
    MOUNTS,
    PERIOD,
    SEGMENT,
    SHAPES,
    SPEED_M_S,
    START,
    Segment,
    points_of,
    write_segment,
)

from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.render.beams import Beams
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import independent_group_of
from shift3d.scenes.waymo.range_image import filled_poses
from shift3d.scenes.waymo.scenes import WaymoScenes

NAME = f"{SEGMENT}-{START + PERIOD}"
TOP_M = np.array(MOUNTS[1][:3])


@pytest.fixture(scope="module")
def segment(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Segment]:
    root = tmp_path_factory.mktemp("waymo")
    return root, write_segment(root)


def rows_of(scene: Scene, made: Segment) -> list[tuple[int, int, slice]]:
    """Return (laser, return, its rows in the scene), in the scene's order."""
    found, start = [], 0
    for laser in sorted(SHAPES):
        for number in (1, 2):
            count = int((made.images[1, laser, number][..., 0] > 0).sum())
            found.append((laser, number, slice(start, start + count)))
            start += count
    assert start == len(scene.points)
    return found


def test_every_pixel_lies_where_the_chain_of_transforms_puts_it(segment: tuple[Path, Segment]) -> None:
    root, made = segment
    scene = WaymoScenes(root).load(NAME)
    for laser, number, rows in rows_of(scene, made):
        points, origins, pixels = points_of(made, 1, laser, number)
        np.testing.assert_allclose(scene.points[rows], points - TOP_M, atol=1e-4)
        np.testing.assert_allclose(scene.origins[rows], origins - TOP_M, atol=1e-4)
        np.testing.assert_array_equal(scene.range_image_index[rows], pixels)
        assert (scene.return_number[rows] == number - 1).all()


def test_range_images_come_back_from_points_and_origins(segment: tuple[Path, Segment]) -> None:
    root, made = segment
    scene = WaymoScenes(root).load(NAME)
    for laser, number, rows in rows_of(scene, made):
        image = made.images[1, laser, number]
        found, seen = np.zeros(image.shape[:2]), tuple(scene.range_image_index[rows].T)
        found[seen] = np.linalg.norm(scene.points[rows].astype(np.float64) - scene.origins[rows], axis=1)
        np.testing.assert_allclose(found, np.where(image[..., 0] > 0, image[..., 0], 0.0), atol=1e-3)
        np.testing.assert_allclose(scene.reflectance[rows], np.tanh(image[..., 1][seen]), rtol=1e-5)
        np.testing.assert_array_equal(scene.in_no_label_zone[rows], image[..., 3][seen] > 0)


def test_beams_fall_along_a_row_in_azimuth_and_down_a_column_in_inclination(segment: tuple[Path, Segment]) -> None:
    """The check uses the TOP laser, which turns with the vehicle by 1.1 degrees a frame, less than a column."""
    root, made = segment
    scene = WaymoScenes(root, lasers=["TOP"]).load(NAME)
    beams = Beams.from_scene(scene)
    first = scene.return_number == 0
    row, column = scene.range_image_index[first].T
    away = beams.directions.numpy()[first]
    azimuth, up = np.arctan2(away[:, 1], away[:, 0]), np.arcsin(away[:, 2])
    for number in range(SHAPES[1][0]):
        along = np.unwrap(azimuth[row == number][np.argsort(column[row == number])])
        assert (np.diff(along) < 0).all()
    for number in range(SHAPES[1][1]):
        assert (np.diff(up[column == number][np.argsort(row[column == number])]) < 0).all()
    np.testing.assert_allclose(
        beams.ranges_m.numpy()[first], made.images[1, 1, 1][row, column, 0].astype(float), atol=1e-3
    )


def test_beams_without_a_return_are_the_pixels_that_have_none(segment: tuple[Path, Segment]) -> None:
    scene = WaymoScenes(segment[0]).load(NAME)
    pixels = sum(height * width for height, width in SHAPES.values())
    assert scene.no_return is not None
    assert len(scene.no_return) == pixels - int((scene.return_number == 0).sum())


def test_labels_weather_and_speed(segment: tuple[Path, Segment]) -> None:
    scene = WaymoScenes(segment[0]).load(NAME)
    at = {name: row for row, name in enumerate(scene.labels.names)}
    np.testing.assert_allclose(scene.labels.boxes[at["VEHICLE"]], np.array(BOX) - [*TOP_M, 0, 0, 0, 0])
    assert scene.labels.classes[at["PEDESTRIAN"]] == "pedestrian"
    inside = points_in_boxes(scene.points, scene.labels.boxes).sum(axis=1)
    np.testing.assert_array_equal(scene.labels.num_points, inside)
    assert scene.conditions.weather == "rain" and scene.conditions.weather_in_points
    assert np.linalg.norm(scene.conditions.ego_velocity_m_s) == pytest.approx(SPEED_M_S, rel=0.01)


def test_widths_of_numbers_and_names_of_lasers_change_nothing(tmp_path: Path, segment: tuple[Path, Segment]) -> None:
    write_segment(tmp_path, transforms=pa.float32(), laser_names=True)
    narrow, wide = WaymoScenes(tmp_path).load(NAME), WaymoScenes(segment[0]).load(NAME)
    # A transform in float32 places the vehicle 800 m from the global origin to 0.06 mm.
    np.testing.assert_allclose(narrow.points, wide.points, atol=1e-3)
    np.testing.assert_array_equal(narrow.range_image_index, wide.range_image_index)


def test_pixels_without_a_pose_have_that_of_their_column() -> None:
    poses = np.zeros((3, 4, 6))
    poses[:2, :3, 3] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    filled = filled_poses(poses, "here")[..., 3]
    np.testing.assert_array_equal(filled, [[1, 2, 3, 3], [4, 5, 6, 6], [4, 5, 6, 6]])
    with pytest.raises(InputError, match="every pixel's pose is zero"):
        filled_poses(np.zeros((2, 2, 6)), "here")


def test_frames_are_listed_in_order_and_chosen(segment: tuple[Path, Segment]) -> None:
    root, _ = segment
    names = [f"{SEGMENT}-{START + frame * PERIOD}" for frame in range(3)]
    assert WaymoScenes(root).names() == names
    assert {independent_group_of("waymo", name) for name in names} == {f"waymo/{SEGMENT}"}, "a tenth of a second apart"
    assert WaymoScenes(root, every=2).names() == names[::2]
    assert WaymoScenes(root, count=2).names() == names[:2]
    assert WaymoScenes(root, names=names[2:]).names() == names[2:]
    with pytest.raises(InputError, match=r"no scene 'x-1'"):
        WaymoScenes(root, names=["x-1"]).names()
    for unknown in ("x-1", f"{SEGMENT}-7", SEGMENT, ""):
        with pytest.raises(InputError):
            WaymoScenes(root).load(unknown)


Spoil = Callable[[Path], None]


def rewrite(component: str, change: Callable[[pa.Table], pa.Table]) -> Spoil:
    def spoil(root: Path) -> None:
        path = root / component / f"{SEGMENT}.parquet"
        pq.write_table(change(pq.read_table(path)), path)

    return spoil


def without_laser(number: int) -> Callable[[pa.Table], pa.Table]:
    return lambda table: table.filter(pc.not_equal(table["key.laser_name"], number))


def with_column(name: str, change: Callable[[list], list]) -> Callable[[pa.Table], pa.Table]:
    def changed(table: pa.Table) -> pa.Table:
        at = table.column_names.index(name)
        values = pa.array([None if row is None else change(row) for row in table[name].to_pylist()], table[name].type)
        return table.set_column(at, table.schema.field(at), values)

    return changed


def truncated(component: str) -> Spoil:
    def spoil(root: Path) -> None:
        path = root / component / f"{SEGMENT}.parquet"
        path.write_bytes(path.read_bytes()[:-100])

    return spoil


def misnamed(component: str) -> Spoil:
    """Damage a letter of a column's name wherever the file has it."""

    def spoil(root: Path) -> None:
        path = root / component / f"{SEGMENT}.parquet"
        path.write_bytes(path.read_bytes().replace(b"key.frame_t", b"key.frame_\xff"))

    return spoil


def not_utf8(table: pa.Table) -> pa.Table:
    weather = "[StatsComponent].weather"
    texts = pa.array([b"\xff"] * len(table)).view(pa.string())
    return table.set_column(table.column_names.index(weather), weather, texts)


def missing(component: str) -> Spoil:
    return lambda root: (root / component / f"{SEGMENT}.parquet").unlink()


def twice(table: pa.Table) -> pa.Table:
    return pa.concat_tables([table, table])


def of_another_segment(table: pa.Table) -> pa.Table:
    return with_column("key.segment_context_name", lambda name: "other")(table)


def later(table: pa.Table) -> pa.Table:
    return with_column("key.frame_timestamp_micros", lambda time: time + 1)(table)


def millimetres(values: list[float]) -> list[float]:
    return [value * 1000.0 if index % 4 == 0 else value for index, value in enumerate(values)]


def one_range(value: float) -> Callable[[list[float]], list[float]]:
    return lambda values: [value, *values[1:]]


def empty(image: str) -> Callable[[pa.Table], pa.Table]:
    return with_column(f"{image}.values", lambda values: [-1.0] * len(values))


FIRST, SECOND = "[LiDARComponent].range_image_return1", "[LiDARComponent].range_image_return2"
POSE = "[LiDARPoseComponent].range_image_return1"
EXTRINSIC = "[LiDARCalibrationComponent].extrinsic.transform"
INCLINATION = "[LiDARCalibrationComponent].beam_inclination"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        *(
            (missing(part), rf"{part}.{SEGMENT}.*missing")
            for part in ("lidar_pose", "lidar_calibration", "vehicle_pose")
        ),
        (missing("lidar_box"), r"lidar_box.*missing"),
        *((truncated(part), rf"{part}.*not a readable Parquet") for part in ("lidar", "lidar_pose", "lidar_box")),
        *((misnamed(part), rf"{part}.*not a readable Parquet.*utf") for part in ("lidar", "vehicle_pose", "lidar_box")),
        (rewrite("stats", not_utf8), r"stats.*not a readable Parquet.*UTF"),
        *(
            (rewrite(part, lambda table: table.slice(0, 0)), rf"{part}.*no rows")
            for part in ("lidar_pose", "lidar_box")
        ),
        *((rewrite(part, of_another_segment), rf"{part}.*segment 'other'") for part in ("lidar_pose", "vehicle_pose")),
        *((rewrite(part, later), rf"{part}.*no row") for part in ("lidar_pose", "vehicle_pose")),
        *(
            (rewrite(part, twice), rf"{part}.*two rows")
            for part in ("lidar", "lidar_pose", "lidar_box", "vehicle_pose")
        ),
        (rewrite("lidar", without_laser(4)), r"lidar.*no row with.*laser_name=4"),
        (rewrite("lidar_calibration", without_laser(4)), r"lidar_calibration.*no row of laser 4"),
        (rewrite("lidar_calibration", without_laser(1)), r"lidar_calibration.*no row of laser 1"),
        (rewrite("lidar_pose", with_column(f"{POSE}.shape", lambda s: [s[1], s[0], s[2]])), r"poses of .180, 16."),
        (rewrite("lidar", with_column(f"{FIRST}.shape", lambda s: [None, *s[1:]])), r"shape \[nan, "),
        (rewrite("lidar_pose", with_column(f"{POSE}.values", lambda v: v[:-6])), r"lidar_pose.*numbers, .* expected"),
        (rewrite("lidar_pose", with_column(f"{POSE}.values", lambda v: [0.0] * len(v))), r"every pixel's pose is zero"),
        (rewrite("lidar", with_column(f"{FIRST}.values", millimetres)), r"range of .* m.*metres"),
        *(
            (
                rewrite("lidar", with_column(f"{image}.values", one_range(value))),
                r"laser 1 at \d+: a range that is not fin",
            )
            for image in (FIRST, SECOND)
            for value in (float("nan"), float("inf"))
        ),
        (rewrite("lidar", lambda table: empty(FIRST)(empty(SECOND)(table))), r"no point with a positive"),
        (rewrite("lidar", lambda table: table.drop_columns([f"{FIRST}.shape"])), r"no column .*return1\.shape"),
        (rewrite("lidar_calibration", with_column(EXTRINSIC, lambda m: [2 * v for v in m])), r"no rotation"),
        (
            rewrite("lidar_calibration", with_column(f"{INCLINATION}.values", lambda v: v[1:])),
            r"15 beam incl.* 16 rows",
        ),
        (rewrite("lidar_calibration", with_column(f"{INCLINATION}.values", lambda v: [57 * x for x in v])), "radians"),
        (rewrite("lidar_box", with_column("[LiDARBoxComponent].type", lambda kind: 7)), r"unknown type 7"),
        (rewrite("lidar_box", with_column("[LiDARBoxComponent].box.size.x", lambda size: -1.0)), r"lidar_box.*dx = -1"),
        (
            rewrite("lidar_box", with_column("[LiDARBoxComponent].box.center.x", lambda x: 1e300)),
            r"lidar_box.*box 0 has",
        ),
        (rewrite("lidar_box", with_column("[LiDARBoxComponent].box.heading", lambda a: 1e9)), r"lidar_box.*two turns"),
    ],
)
def test_what_does_not_fit_together_gives_one_clear_line(tmp_path: Path, spoil: Spoil, says: str) -> None:
    write_segment(tmp_path)
    spoil(tmp_path)
    with pytest.raises(InputError, match=says) as caught:
        WaymoScenes(tmp_path).load(NAME)
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_without_labels_and_weather_there_are_none(tmp_path: Path) -> None:
    write_segment(tmp_path)
    for part in ("lidar_box", "stats"):
        (tmp_path / part / f"{SEGMENT}.parquet").unlink()
        (tmp_path / part).rmdir()
    scene = WaymoScenes(tmp_path).load(NAME)
    assert len(scene.labels.boxes) == 0 and scene.conditions.weather == "dry"


def test_folders_that_are_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no component lidar/"):
        WaymoScenes(tmp_path)
    (tmp_path / "lidar").mkdir()
    with pytest.raises(InputError, match=r"lidar: no scenes"):
        WaymoScenes(tmp_path).names()
    with pytest.raises(InputError, match=r"unknown laser 'BACK'.*REAR"):
        WaymoScenes(tmp_path, lasers=["BACK"])
    with pytest.raises(InputError, match=r"a laser twice in scenes\.lasers=\[TOP,REAR,TOP\]"):
        WaymoScenes(tmp_path, lasers=["TOP", "REAR", "TOP"])


def test_a_bad_segment_is_listed_where_bad_scenes_are_kept(tmp_path: Path) -> None:
    write_segment(tmp_path, frames=1)
    (tmp_path / "lidar" / "another.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"another\.parquet"):
        WaymoScenes(tmp_path).names()
    scenes = WaymoScenes(tmp_path, list_unreadable=True)
    assert scenes.names() == [f"{SEGMENT}-{START}", "another"]
    named = WaymoScenes(tmp_path, [f"{SEGMENT}-{START}", "another-5"], list_unreadable=True)
    assert named.names() == [f"{SEGMENT}-{START}", "another-5"]
    for one, name in ((scenes, "another"), (named, "another-5")):
        with pytest.raises(InputError, match=r"another\.parquet.*not a readable"):
            one.load(name)


def test_one_frame_of_many_is_read_without_the_others(segment: tuple[Path, Segment], tmp_path: Path) -> None:
    """Rows of other frames are not read: defects in them are not noticed."""
    write_segment(tmp_path)
    path = tmp_path / "lidar" / f"{SEGMENT}.parquet"
    table = pq.read_table(path)
    shapes = table[f"{FIRST}.shape"].to_pylist()
    times = table["key.frame_timestamp_micros"].to_pylist()
    spoiled = [shape if time == START + PERIOD else [0, 0, 0] for shape, time in zip(shapes, times, strict=True)]
    at = table.column_names.index(f"{FIRST}.shape")
    pq.write_table(table.set_column(at, table.schema.field(at), pa.array(spoiled, pa.list_(pa.int32(), 3))), path)
    assert WaymoScenes(tmp_path).load(NAME).content_hash() == WaymoScenes(segment[0]).load(NAME).content_hash()


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for root in (tmp_path / "file", tmp_path / "absent"):
        with pytest.raises(InputError, match="lidar"):
            WaymoScenes(root)
