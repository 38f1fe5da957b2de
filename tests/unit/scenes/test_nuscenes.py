"""nuScenes: a release written in its schema, several sweeps joined, the real sample, and damaged files."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from analytic_fields import Frame, box, in_frame
from nuscenes_release import (
    BOX,
    MOUNT_M,
    PERIOD_US,
    SPEED_M_S,
    START_US,
    VERSION,
    change_table,
    drive_at,
    global_SE3_lidar,
    pose,
    scan,
    write_release,
)

from shift3d.effects.chain import EffectChain
from shift3d.errors import InputError
from shift3d.render import preset
from shift3d.scenes.facts import EffectSettings
from shift3d.scenes.nuscenes.scenes import NuScenesScenes
from shift3d.scenes.nuscenes.tables import table_rows
from shift3d.store.resolve import as_location


def road_from_scene(time_s: float) -> np.ndarray:
    """Return the transform to the vehicle's frame at the first key frame from a scene at a time of the first drive."""
    start = np.linalg.inv(pose(*drive_at(0.0, 0)))
    now = start @ pose(*drive_at(time_s, 0))
    now[:3, 3] = (start @ global_SE3_lidar(time_s, 0))[:3, 3]
    return now


def test_a_key_frame_has_the_points_of_its_file_in_the_vehicles_axes(tmp_path: Path) -> None:
    write_release(tmp_path)
    scenes = NuScenesScenes(tmp_path)
    assert scenes.names() == ["sample00", "sample01", "sample02"]
    scene = scenes.load("sample01")
    time_s = 3 * PERIOD_US * 1e-6
    raw = scan(global_SE3_lidar(time_s, 0), 0)
    np.testing.assert_allclose(np.linalg.norm(scene.points, axis=1), np.linalg.norm(raw[:, :3], axis=1), atol=1e-3)
    assert (scene.origins == 0).all() and scene.time_s is None
    on_road = scene.points[:-2] @ road_from_scene(time_s)[:3, :3].T + road_from_scene(time_s)[:3, 3]
    level = np.abs(on_road[:, 2]) < 1e-3
    assert (level | (np.abs(np.abs(on_road[:, 1]) - 12.0) < 1e-3)).all() and level.sum() > 100
    assert scene.ground_z_m == pytest.approx(-MOUNT_M[2], abs=0.01)
    np.testing.assert_allclose(scene.conditions.ego_velocity_m_s, (SPEED_M_S, 0.0, 0.0), atol=1e-3)
    assert scene.conditions.weather == "rain"


@pytest.mark.parametrize(
    ("description", "weather"),
    [("Rain, wait at light", "rain"), ("Rainy night", "rain"), ("Light raining", "rain"), ("After rain", "rain"),
     ("Level crossing, train passes", "dry"), ("Rough terrain", "dry"), ("Drainage works", "dry")],
)  # fmt: skip
def test_rain_is_a_word(tmp_path: Path, description: str, weather: str) -> None:
    write_release(tmp_path, description=description)
    assert NuScenesScenes(tmp_path).load("sample01").conditions.weather == weather


def test_boxes_have_length_before_width_and_stand_where_the_global_frame_has_them(tmp_path: Path) -> None:
    write_release(tmp_path)
    labels = NuScenesScenes(tmp_path).load("sample01").labels
    expected = np.array(BOX) - [SPEED_M_S * 0.15 + MOUNT_M[0], 0, MOUNT_M[2], 0, 0, 0, 0]
    at = labels.names.index("vehicle.car")
    np.testing.assert_allclose(labels.boxes[at], expected, atol=1e-6)
    assert labels.classes[at] == "vehicle" and labels.classes[1 - at] == "cyclist"


def test_joined_sweeps_lie_on_the_same_world_and_start_where_the_sensor_was(tmp_path: Path) -> None:
    write_release(tmp_path)
    scene = NuScenesScenes(tmp_path, sweeps=3).load("sample01")
    ages = np.unique(scene.time_s)
    np.testing.assert_allclose(ages, [-0.1, -0.05, 0.0], atol=1e-6)
    own = np.linalg.norm(scene.points - scene.origins, axis=1) < 2
    assert own.sum() == 2 and (scene.time_s[own] == 0).all()  # the car's own roof is dropped from earlier sweeps
    placed = road_from_scene(3 * PERIOD_US * 1e-6)
    on_road = scene.points[~own] @ placed[:3, :3].T + placed[:3, 3]
    assert ((np.abs(on_road[:, 2]) < 1e-3) | (np.abs(np.abs(on_road[:, 1]) - 12.0) < 1e-3)).all()
    for age in ages:
        origin = scene.origins[scene.time_s == age]
        np.testing.assert_allclose(origin, np.broadcast_to([SPEED_M_S * age, 0, 0], origin.shape), atol=1e-4)
    assert len(NuScenesScenes(tmp_path, sweeps=9).load("sample00").points) < len(scene.points) / 2  # no earlier sweep


def test_an_inserted_vehicle_moves_through_the_sweeps_as_it_drives(tmp_path: Path) -> None:
    write_release(tmp_path)
    scene = NuScenesScenes(tmp_path, sweeps=3).load("sample01")
    frame, theta = Frame(size_m=(4.0, 2.0, 1.6), scale_m=1.0), torch.tensor([9.0, 0.0, -1.0, 0.0, 0.0, 0.0]).double()
    field = in_frame(box((2.0, 1.0, 0.8)), frame)
    for speed in (0.0, 10.0):
        effects = EffectSettings(object_speed_m_s=speed)
        chain = EffectChain.of(["origins", "rolling_shutter"], scene, frame, 1, effects)
        rendering = chain.render(field, theta, preset("reference").with_(step_m=0.02))
        hit = rendering.hit_mask.numpy()
        rear = rendering.points.detach().numpy()[hit, 0] - speed * scene.time_s[hit]
        on_rear = np.abs(rear - 7.0) < 1e-5
        assert {*np.unique(scene.time_s[hit][on_rear])} == {*np.unique(scene.time_s)}
        assert on_rear.mean() > 0.4  # the others are on its roof and sides
        assert (rear > 7.0 - 1e-5).all() and (rear < 11.0 + 1e-5).all()


def test_versions_and_names_are_chosen(tmp_path: Path) -> None:
    write_release(tmp_path, drives=2)
    (tmp_path / "v1.0-mini.tgz").write_bytes(b"the archive that it came in")
    every = NuScenesScenes(tmp_path).names()
    assert every == ["sample00", "sample01", "sample02", "sample10", "sample11", "sample12"]
    assert NuScenesScenes(tmp_path, count=2).names() == every[:2]
    assert NuScenesScenes(tmp_path, names=["sample12"]).load("sample12").scene_id == "sample12"
    with pytest.raises(InputError, match=r"no scene 'sample99'"):
        NuScenesScenes(tmp_path, names=["sample99"]).names()
    with pytest.raises(InputError, match=r"unknown scene 'sample99'"):
        NuScenesScenes(tmp_path).load("sample99")
    with pytest.raises(InputError, match=r"unknown scene 'sample10'.*Choose from: sample00, sample01"):
        NuScenesScenes(tmp_path, count=2).load("sample10")
    (tmp_path / "v1.0-trainval").mkdir()
    with pytest.raises(InputError, match=r"2 versions of tables.*scenes\.version"):
        NuScenesScenes(tmp_path)
    assert NuScenesScenes(tmp_path, version=VERSION).names() == every
    with pytest.raises(InputError, match=r"no tables v1\.0-test"):
        NuScenesScenes(tmp_path, version="v1.0-test")


def drop_lidar(root: Path) -> None:
    next((root / "samples" / "LIDAR_TOP").glob(f"*{START_US + 3 * PERIOD_US}*")).unlink()


def rewrite_lidar(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def spoil(root: Path) -> None:
        path = next((root / "samples" / "LIDAR_TOP").glob(f"*{START_US + 3 * PERIOD_US}*"))
        change(np.fromfile(path, "<f4").reshape(-1, 5)).astype("<f4").tofile(path)

    return spoil


def table(name: str, change: Callable[[list[dict[str, Any]]], Any]) -> Callable[[Path], None]:
    return lambda root: change_table(root, name, change)


def without(key: str) -> Callable[[list[dict[str, Any]]], Any]:
    return lambda rows: [{k: v for k, v in row.items() if k != key} for row in rows]


def changed(name: str, **values: Any) -> Callable[[Path], None]:
    return table(name, lambda rows: [row | values for row in rows])


def cut(root: Path) -> None:
    path = root / VERSION / "sample_data.json"
    path.write_text(path.read_text()[:-30])


TABLES = (
    "sample_data",
    "ego_pose",
    "calibrated_sensor",
    "sample_annotation",
    "instance",
    "category",
    "sample",
    "scene",
)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        *((lambda r, t=t: (r / VERSION / f"{t}.json").unlink(), rf"{t}\.json: the table is missing") for t in TABLES),
        *((table(t, lambda rows: []), rf"{t}\.json.*no rows") for t in ("sample_data", "ego_pose", "category")),
        (cut, r"sample_data\.json.*cut short"),
        (table("sample_data", lambda rows: ["x"]), r"sample_data\.json.*'x', not an object"),
        (table("sample_data", without("filename")), r"no scene|no scenes"),
        (table("sample_data", without("timestamp")), r"sample_data\.json.*has no timestamp"),
        (table("ego_pose", lambda rows: rows[:1]), r"ego_pose\.json: no row pose0"),
        (table("ego_pose", without("rotation")), r"ego_pose\.json.*no rotation and translation"),
        (changed("sample_data", timestamp=None), r"sample_data\.json: row \S+ has timestamp None"),
        (table("sample_annotation", without("size")), r"no size of 3 numbers"),
        (changed("sample_annotation", size=[None, 1, 2]), r"no size of 3 numbers"),
        (changed("sample_annotation", size=None), r"no size of 3 numbers"),
        (table("instance", lambda rows: rows[:1]), r"sample_annotation\.json.*no category"),
        (drop_lidar, r"pcd\.bin.*missing"),
        (rewrite_lidar(lambda v: v.ravel()[:-1]), r"pcd\.bin.*bytes"),
        (rewrite_lidar(lambda v: v * (100, 100, 100, 1, 1)), r"median range is .*metres"),
        (rewrite_lidar(lambda v: v * (np.nan, 1, 1, 1, 1)), r"is not finite. Copy it again"),
        (rewrite_lidar(lambda v: v * (1, 1, 1, 257, 1)), r"intensity that is not 0 to 255"),
    ],
)
def test_damaged_files_give_one_clear_line(tmp_path: Path, spoil: Callable[[Path], None], says: str) -> None:
    write_release(tmp_path)
    spoil(tmp_path)
    with pytest.raises(InputError, match=says) as caught:
        scenes = NuScenesScenes(tmp_path)
        scenes.load(scenes.names()[1])
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "token", "values"),
    [
        ("ego_pose", "pose10", {"rotation": [0, 0, 0, 0]}),
        ("ego_pose", "pose10", {"token": "another"}),
        ("sample_annotation", "asample10", {"instance_token": "another"}),
        ("sample_annotation", "asample10", {"translation": None}),
        ("sample_annotation", "asample10", {"size": "large"}),
    ],
)
def test_a_bad_row_refuses_the_scenes_that_use_it(
    tmp_path: Path, name: str, token: str, values: dict[str, Any]
) -> None:
    write_release(tmp_path, drives=2)
    change_table(tmp_path, name, lambda rows: [row | (values if row["token"] == token else {}) for row in rows])
    scenes, refused = NuScenesScenes(tmp_path), []
    for scene in scenes.names():
        try:
            scenes.load(scene)
        except InputError as error:
            refused.append(scene)
            assert f"{name}.json" in error.where
    assert refused == ["sample10"]


@pytest.mark.parametrize(
    ("labelled", "sweeps", "says"),
    [
        (True, 1, r"sample_annotation\.json, sample sample02: box 0 .*the pose of its frame"),
        (False, 1, "conditions.ego_velocity_m_s"),
        (False, 2, "origins: the beam of row"),
    ],
)
def test_a_sweep_of_another_town_is_refused(tmp_path: Path, labelled: bool, sweeps: int, says: str) -> None:
    write_release(tmp_path)
    if not labelled:
        change_table(tmp_path, "sample_annotation", lambda rows: [])
    change_table(tmp_path, "ego_pose", lambda rows: rows[2].update(translation=[20_000.0, 0.0, 0.0]))
    with pytest.raises(InputError, match=says):
        NuScenesScenes(tmp_path, sweeps=sweeps).load("sample02")


def test_rows_of_a_table_are_read_across_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import shift3d.scenes.nuscenes.tables as module

    write_release(tmp_path)
    file = as_location(tmp_path / VERSION / "ego_pose.json")
    whole = list(table_rows(file))
    monkeypatch.setattr(module, "_PIECE", 37)
    assert list(table_rows(file)) == whole and len(whole) == 7


def test_folders_that_are_no_release(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"neither tables v1\.0-\*/ nor \*\.pcd\.bin files"):
        NuScenesScenes(tmp_path)


def test_files_alone_are_one_sweep_each(tmp_path: Path) -> None:
    """A detector of ten sweeps would otherwise silently receive one."""
    scan(global_SE3_lidar(0.0, 0), 0).astype("<f4").tofile(tmp_path / "one.pcd.bin")
    assert NuScenesScenes(tmp_path, sweeps=1).names() == ["one"]
    with pytest.raises(InputError, match=r"no tables.*sweeps=10 cannot be joined.*scenes\.sweeps=1"):
        NuScenesScenes(tmp_path, sweeps=10)


def test_numbers_of_another_width_are_no_metres_and_warn_of_nothing(tmp_path: Path) -> None:
    scan(global_SE3_lidar(0.0, 0), 0).astype("<f8").tofile(tmp_path / "wide.pcd.bin")
    scenes = NuScenesScenes(tmp_path)
    with warnings.catch_warnings(), pytest.raises(InputError, match=r"wide\.pcd\.bin: .*(range|bytes).*"):
        warnings.simplefilter("error")
        scenes.load("wide")


def test_the_real_file_turns_clockwise_and_its_rings_rise(real_data: Callable[[str], Path]) -> None:
    root = real_data("nuscenes")
    scenes = NuScenesScenes(root)
    (name,) = scenes.names()
    scene = scenes.load(name)
    raw = np.fromfile(root / f"{name}.pcd.bin", "<f4").reshape(-1, 5)
    reach = np.linalg.norm(scene.points.astype(np.float64) - scene.origins, axis=1)
    np.testing.assert_allclose(reach, np.linalg.norm(raw[:, :3], axis=1), atol=1e-4)
    far, ring = reach > 2.0, raw[:, 4]
    azimuth, up = np.arctan2(scene.points[:, 1], scene.points[:, 0]), np.arcsin(scene.points[:, 2] / reach)
    elevations, steps = [], []
    for number in range(32):
        rows = np.flatnonzero(far & (ring == number))
        steps.append(np.mod(np.diff(azimuth[rows]) + np.pi, 2 * np.pi) - np.pi)
        elevations.append(np.median(up[rows]))
    assert (np.diff(elevations) > 0.02).all()
    assert (np.concatenate(steps) < 0).mean() > 0.995  # compensation for the car's motion reorders a few near ones


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for root in (tmp_path / "file", tmp_path / "absent"):
        with pytest.raises(InputError, match="neither"):
            NuScenesScenes(root)
