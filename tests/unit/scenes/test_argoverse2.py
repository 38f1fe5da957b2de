"""Argoverse 2: a log written in its schema, the real sample, float16 jitter, and damaged files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.feather as feather
import pytest
from argoverse2_log import BOX, COLUMNS, DOWN, LOG, PERIOD, SPEED_M_S, START, UP, city_SE3_ego, write_log

from shift3d.errors import InputError
from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import independent_group_of

NAME = f"{LOG}-{START + PERIOD}"
# Half a step of float16 is at most 2**-11 of the number, which is stored in the vehicle frame.
JITTER = 2.0**-11


def beams(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ranges, azimuths and elevations of the points from their own origins."""
    away = scene.points.astype(np.float64) - scene.origins
    reach = np.linalg.norm(away, axis=1)
    return reach, np.arctan2(away[:, 1], away[:, 0]), np.arcsin(away[:, 2] / reach)


def jitter_m(scene: Scene, mount: tuple[float, float, float] = UP) -> np.ndarray:
    """Return (N,) the largest displacement of a point by rounding to float16, metres."""
    return JITTER * np.linalg.norm(scene.points + np.array(mount), axis=1) + 1e-3


@pytest.mark.parametrize("width", [np.float16, np.float32])
def test_beams_are_those_that_were_cast(tmp_path: Path, width: type) -> None:
    write_log(tmp_path, width=width)
    scene = Argoverse2Scenes(tmp_path).load(NAME)
    reach, azimuth, up = beams(scene)
    rng = np.random.default_rng((START + PERIOD) % 1000)
    off = jitter_m(scene) if width is np.float16 else np.full(len(reach), 2e-4)
    assert (np.abs(reach - rng.uniform(3.0, 90.0, len(reach))) <= off).all()
    for laser in range(64):
        rows = np.arange(laser, 64 * COLUMNS, 64)  # the file has column after column
        step = np.diff(np.unwrap(azimuth[rows]))
        bound = (off[rows] / (reach[rows] * np.cos(up[rows])))[1:] * 2
        assert (step < bound).all()
        assert (np.abs(step + 2 * np.pi / COLUMNS) < 2 * bound + 1e-4).all()
        assert np.abs(up[rows] - np.median(up[rows])).max() < (off[rows] / reach[rows]).max() * 2


def test_origins_follow_the_vehicle_and_each_lidar(tmp_path: Path) -> None:
    write_log(tmp_path)
    scene = Argoverse2Scenes(tmp_path).load(NAME)
    start = np.linalg.inv(city_SE3_ego(START + PERIOD))
    for row in (0, 31, 32, 64 * COLUMNS - 1):
        mount = UP if row % 64 < 32 else DOWN
        fired = round(float(scene.time_s[row]) * 1e9)
        expected = (start @ city_SE3_ego(START + PERIOD + fired) @ [*mount, 1.0])[:3] - UP
        np.testing.assert_allclose(scene.origins[row], expected, atol=1e-4)
    assert np.linalg.norm(scene.conditions.ego_velocity_m_s) == pytest.approx(SPEED_M_S, rel=0.01)


def test_labels_are_in_the_scenes_frame(tmp_path: Path) -> None:
    write_log(tmp_path, counts=False)
    labels = Argoverse2Scenes(tmp_path).load(NAME).labels
    np.testing.assert_allclose(labels.boxes[0], np.array(BOX) - [*UP, 0, 0, 0, 0], atol=1e-9)
    assert labels.names == ("REGULAR_VEHICLE", "PEDESTRIAN") and labels.classes == ("vehicle", "pedestrian")


def test_labels_belong_to_a_sweep_by_every_nanosecond(tmp_path: Path) -> None:
    """The boxes of another time are not the sweep's, even if float64 gives both times one value."""
    other = START + PERIOD + 1
    assert float(other) == float(START + PERIOD)

    def moved(table: pa.Table) -> pa.Table:
        times = table["timestamp_ns"].to_pylist()
        at = table.column_names.index("timestamp_ns")
        return table.set_column(at, "timestamp_ns", pa.array([START, START, START + PERIOD, other][: len(times)]))

    rewrite(BOXES, moved)(write_log(tmp_path))
    assert Argoverse2Scenes(tmp_path).load(NAME).labels.names == ("REGULAR_VEHICLE",)


def test_a_sweep_without_annotations_is_unlabelled(tmp_path: Path) -> None:
    log = write_log(tmp_path)
    rewrite(BOXES, lambda table: table.filter(pc.equal(table["timestamp_ns"], START)))(log)
    assert len(Argoverse2Scenes(tmp_path).load(NAME).labels.boxes) == 0


def test_the_velocity_is_unknown_where_no_pose_is_later(tmp_path: Path) -> None:
    log = write_log(tmp_path)
    rewrite(SWEEP, scaled("offset_ns", 0.1))(log)
    rewrite(POSES, poses_until(40_000_000))(log)
    velocity = Argoverse2Scenes(tmp_path).load(NAME).conditions.ego_velocity_m_s
    assert velocity is not None and np.linalg.norm(velocity) == pytest.approx(SPEED_M_S, rel=0.01)
    rewrite(POSES, poses_until(0))(log)
    assert Argoverse2Scenes(tmp_path).load(NAME).conditions.ego_velocity_m_s is None


def test_sweeps_are_listed_in_order_and_chosen(tmp_path: Path) -> None:
    log = write_log(tmp_path, sweeps=3, labels=False)
    names = [f"{LOG}-{START + sweep * PERIOD}" for sweep in range(3)]
    assert Argoverse2Scenes(tmp_path).names() == Argoverse2Scenes(log).names() == names
    assert {independent_group_of("argoverse2", name) for name in names} == {f"argoverse2/{LOG}"}, (
        "a tenth of a second apart"
    )
    assert Argoverse2Scenes(tmp_path, every=2).names() == names[::2]
    assert Argoverse2Scenes(tmp_path, count=1).names() == names[:1]
    assert Argoverse2Scenes(tmp_path, names=names[1:]).names() == names[1:]
    assert len(Argoverse2Scenes(tmp_path).load(names[0]).labels.boxes) == 0
    with pytest.raises(InputError, match=r"no scene 'x-1'"):
        Argoverse2Scenes(tmp_path, names=["x-1"]).names()
    named = Argoverse2Scenes(tmp_path, [names[0], f"{LOG}-1"], list_unreadable=True)
    assert named.names() == [names[0], f"{LOG}-1"], "a wrong one is reported when it is loaded"
    for unknown in ("x-1", LOG, f"{LOG}-1", ""):
        with pytest.raises(InputError):
            Argoverse2Scenes(tmp_path).load(unknown)


Spoil = Callable[[Path], None]
SWEEP = f"sensors/lidar/{START + PERIOD}.feather"
POSES, MOUNTS, BOXES = "city_SE3_egovehicle.feather", "calibration/egovehicle_SE3_sensor.feather", "annotations.feather"


def rewrite(part: str, change: Callable[[pa.Table], pa.Table]) -> Spoil:
    def spoil(log: Path) -> None:
        table = feather.read_table(log / part, memory_map=False)
        feather.write_feather(change(table), log / part)

    return spoil


def scaled(name: str, factor: float) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        at = table.column_names.index(name)
        values = table[name].to_numpy().astype(np.float64) * factor
        return table.set_column(at, name, pa.array(values))

    return change


def halved_times(table: pa.Table) -> pa.Table:
    at = table.column_names.index("timestamp_ns")
    return table.set_column(at, "timestamp_ns", pc.divide(table["timestamp_ns"], 2))


def first_of(name: str, value: float) -> Callable[[pa.Table], pa.Table]:
    """Return a change that puts a value into the first row of a column, which becomes a column of floats."""

    def change(table: pa.Table) -> pa.Table:
        values = table[name].to_numpy().astype(np.float64)
        return table.set_column(table.column_names.index(name), name, pa.array([value, *values[1:]]))

    return change


def cut(part: str) -> Spoil:
    return lambda log: (log / part).write_bytes((log / part).read_bytes()[:-40])


def poses_until(offset_ns: int) -> Callable[[pa.Table], pa.Table]:
    """Return a change that drops the poses later than a time after the second sweep's start."""
    return lambda table: table.filter(pc.less_equal(table["timestamp_ns"], START + PERIOD + offset_ns))


def as_text(table: pa.Table) -> pa.Table:
    at = table.column_names.index("timestamp_ns")
    return table.set_column(at, "timestamp_ns", table["timestamp_ns"].cast(pa.string()))


def not_utf8(name: str) -> Callable[[pa.Table], pa.Table]:
    """Write a text column whose bytes are not UTF-8."""

    def change(table: pa.Table) -> pa.Table:
        texts = pa.array([b"\xff"] * len(table)).view(pa.string())
        return table.set_column(table.column_names.index(name), name, texts)

    return change


def misnamed(part: str, name: bytes) -> Spoil:
    """Damage the last byte of a column's name wherever the file has it."""
    return lambda log: (log / part).write_bytes((log / part).read_bytes().replace(name, name[:-1] + b"\xff"))


def centimetres(table: pa.Table) -> pa.Table:
    for name in "xyz":
        table = scaled(name, 100.0)(table)
    return table


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        *((lambda log, part=part: (log / part).unlink(), rf"{part}.*missing") for part in (SWEEP, POSES, MOUNTS)),
        *((cut(part), rf"{part}.*not a readable Feather") for part in (SWEEP, POSES, MOUNTS, BOXES)),
        *((rewrite(part, lambda table: table.slice(0, 0)), rf"{part}.*no rows") for part in (SWEEP, POSES, BOXES)),
        (rewrite(SWEEP, lambda table: table.drop_columns(["offset_ns"])), r"no column offset_ns"),
        (rewrite(SWEEP, centimetres), r"median range is .* m.*metres"),
        (rewrite(SWEEP, scaled("x", float("nan"))), r"row 0 is not finite. Copy it again"),
        (rewrite(SWEEP, scaled("laser_number", 2.0)), r"laser numbers up to 126"),
        (rewrite(SWEEP, scaled("intensity", 257.0)), r"intensity that is not 0 to 255"),
        (rewrite(SWEEP, scaled("offset_ns", 1e-3)), r"firing times from .* nanoseconds"),
        (rewrite(SWEEP, scaled("offset_ns", -1.0)), r"firing times from -"),
        (rewrite(POSES, halved_times), r"no pose near the sweep"),
        (rewrite(POSES, poses_until(0)), r"no pose near the sweep \d+, 99\.\d* ms after its start.*one log"),
        (rewrite(POSES, poses_until(-30_000_000)), r"no pose near the sweep \d+, 0 ms after its start.*one log"),
        (rewrite(POSES, scaled("qw", 1.5)), r"no unit quaternion"),
        (rewrite(MOUNTS, lambda table: table.slice(0, 2)), r"0 rows of down_lidar"),
        (rewrite(BOXES, lambda t: t.set_column(2, "category", pa.array(["CAR"] * len(t)))), r"unknown category 'CAR'"),
        *((rewrite(p, not_utf8(n)), rf"{p}.*Feather.*UTF") for p, n in ((BOXES, "category"), (MOUNTS, "sensor_name"))),
        *((misnamed(p, n), rf"{p}.*Feather.*utf") for p, n in ((SWEEP, b"offset_ns"), (MOUNTS, b"sensor_name"))),
        (rewrite(BOXES, as_text), r"annotations\.feather: column timestamp_ns has gaps or is no numbers"),
        (rewrite(BOXES, halved_times), r"annotations\.feather: it annotates no sweep of the log"),
        *(
            (
                rewrite(part, scaled("timestamp_ns", 1.0)),
                rf"{part}: column timestamp_ns .* as its type float64 is exact",
            )
            for part in (POSES, BOXES)
        ),
        *(
            (rewrite(part, first_of(name, value)), rf"{part}: column {name} has values that are NaN")
            for part, name in (
                (POSES, "timestamp_ns"),
                (BOXES, "timestamp_ns"),
                (SWEEP, "offset_ns"),
                (SWEEP, "laser_number"),
            )
            for value in (float("nan"), float("inf"), -1e19)
        ),
        (rewrite(BOXES, scaled("length_m", 0.0)), r"annotations\.feather, sweep .*dx = 0"),
        (rewrite(BOXES, scaled("tz_m", float("nan"))), r"annotations\.feather.*finite translation"),
    ],
)
def test_damaged_files_give_one_clear_line(tmp_path: Path, spoil: Spoil, says: str) -> None:
    log = write_log(tmp_path)
    spoil(log)
    with pytest.raises(InputError, match=says) as caught:
        Argoverse2Scenes(tmp_path).load(NAME)
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_a_log_has_its_name_wherever_one_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_log(tmp_path / "some-log")
    monkeypatch.chdir(log)
    assert Argoverse2Scenes(".").names() == Argoverse2Scenes(log).names()


def test_a_sweep_that_is_named_is_read_whatever_every(tmp_path: Path) -> None:
    log = write_log(tmp_path / "some-log")
    for name in Argoverse2Scenes(log).names():
        assert Argoverse2Scenes(log, [name], every=1000).names() == [name]


def test_folders_without_logs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no logs"):
        Argoverse2Scenes(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no scenes"):
        Argoverse2Scenes(tmp_path).names()


def test_a_data_set_in_place_of_its_split_is_told_which(tmp_path: Path) -> None:
    write_log(tmp_path / "val")
    (tmp_path / "train").mkdir()
    with pytest.raises(InputError, match=r"not one of its splits.*Give .*val"):
        Argoverse2Scenes(tmp_path).names()


def test_real_boxes_hold_the_points_that_their_labels_count(real_data: Callable[[str], Path]) -> None:
    root = real_data("argoverse2") / "val"
    scenes = Argoverse2Scenes(root)
    assert len(scenes.names()) == 2
    for name in scenes.names():
        scene = scenes.load(name)
        log, _, timestamp = name.rpartition("-")
        table = feather.read_table(root / log / "annotations.feather")
        given = table.filter(pc.equal(table["timestamp_ns"], int(timestamp)))["num_interior_pts"].to_numpy()
        assert given.sum() > 9000
        assert (np.abs(scene.labels.num_points - given) <= 0.02 * given).all()


def test_real_beams_turn_clockwise_and_keep_their_elevation(real_data: Callable[[str], Path]) -> None:
    """The azimuths are in the order of the firing times, except for jitter; each beam has one elevation."""
    root = real_data("argoverse2") / "val"
    scenes = Argoverse2Scenes(root)
    name = scenes.names()[0]
    scene = scenes.load(name)
    log, _, timestamp = name.rpartition("-")
    laser = feather.read_table(root / log / "sensors" / "lidar" / f"{timestamp}.feather")["laser_number"].to_numpy()
    reach, azimuth, up = beams(scene)
    bound = jitter_m(scene) / (reach * np.cos(up))
    far, spreads = reach > 5.0, []
    for number in np.unique(laser):
        rows = np.flatnonzero((laser == number) & far)
        if len(rows) < 100:
            continue
        rows = rows[np.argsort(scene.time_s[rows], kind="stable")]
        step = np.mod(np.diff(azimuth[rows]) + np.pi, 2 * np.pi) - np.pi
        assert (step <= bound[rows][1:] + bound[rows][:-1]).all()
        spreads.append(np.ptp(np.percentile(up[rows], (25, 75))))
    assert np.degrees(np.median(spreads)) < 0.12  # 0.22 if the two LiDARs are swapped


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for root in (tmp_path / "file", tmp_path / "absent"):
        with pytest.raises(InputError, match="logs"):
            Argoverse2Scenes(root)
