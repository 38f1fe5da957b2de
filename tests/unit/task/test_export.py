"""A solution exported from the sweep: loaded again, it equals the scored scene."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import valid_sweeps
from short_tasks import by_method, make_spec

from shift3d.attack.objective import SCORE_RADIUS_M, detection_score, object_box, to_network_frame, window_around
from shift3d.cli.main import main
from shift3d.detectors.loading import load_detector
from shift3d.detectors.nms import suppress
from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.geometry.se3 import object_from_scene, scene_from_object
from shift3d.scenes.kitti.files import lidar_box
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.kitti.writing import CALIBRATION, label_line
from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final
from shift3d.task.assets import Assets
from shift3d.task.exchange import Row, TaskResult
from shift3d.task.follow_ups import export
from shift3d.task.follow_ups.export import FRAME, check_no_export, export_solution
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.problem import build_problem
from shift3d.task.scoring import SCORE_FLOOR, SUPPRESSION_IOU

BOX = ("x", "y", "z", "dx", "dy", "dz", "heading")
POSE = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")
SPEC = make_spec()


def wrapped(yaw_rad: torch.Tensor) -> float:
    return math.remainder(float(yaw_rad), 2.0 * math.pi)


@pytest.fixture(scope="module")
def exported(shape: TaskResult, assets: Assets, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Row, Row]:
    """The folder, the solution and its row of scores."""
    folder = tmp_path_factory.mktemp("export")
    (solution,) = (row for row in shape.solutions if row["method"] == "adversarial")
    (scored,) = by_method(shape, "adversarial")
    written = export_solution(SPEC, solution, assets, folder)
    assert all(path.is_file() for path in written)
    return folder, solution, scored


def test_export_renders_the_solution_again(exported: tuple[Path, Row, Row], assets: Assets) -> None:
    folder, _, scored = exported
    scene, _ = assets.scene(SPEC)
    points = np.fromfile(folder / "scene.bin", dtype="<f4").reshape(-1, 4)
    hits = np.load(folder / "hit_mask.npy", allow_pickle=False)
    assert len(points) == len(scene.points) == len(hits)
    assert hits.sum() == scored["object_points"]
    # Points that the vehicle does not hide are unchanged bit for bit; hidden ones came nearer along their own beam.
    assert np.array_equal(points[~hits, :3], scene.points[~hits])
    moved, original = points[hits, :3].astype(float), scene.points[hits].astype(float)
    assert (np.linalg.norm(moved, axis=1) < np.linalg.norm(original, axis=1)).all()
    cosine = (moved * original).sum(1) / np.linalg.norm(moved, axis=1) / np.linalg.norm(original, axis=1)
    assert cosine.min() > 1 - 1e-10

    mesh = trimesh.load(folder / "object.ply")
    _, distance, _ = trimesh.proximity.closest_point(mesh, moved[::20])
    assert np.median(distance) < 0.01  # the mesh is marching cubes at about 4 cm, the points are exact

    box = json.loads((folder / "box.json").read_text())
    assert box["frame"] == "lidar" and box["object_points"] == hits.sum()
    values = np.array([[box["box"][name] for name in BOX]])
    assert points_in_boxes(moved, values, margin_m=0.5).mean() > 0.95
    # Its own box is that of the mesh in the vehicle's axes.
    own = np.array([box["own_box"][name] for name in BOX])
    theta = torch.tensor([box["pose"][name] for name in POSE], dtype=torch.float64)
    vertices = object_from_scene(torch.from_numpy(np.array(mesh.vertices, dtype=np.float64)), theta).numpy()
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    assert own[3:6] == pytest.approx(high - low, abs=1e-4) and own[6] == wrapped(theta[3])
    middle = scene_from_object(torch.from_numpy((low + high)[None] / 2.0), theta).numpy()[0]
    assert own[:3] == pytest.approx(middle, abs=1e-4)
    assert np.abs(own[3:6] - values[0, 3:6]).max() > 0.01


def test_the_frame_loaded_again_has_the_score_of_the_sweep(exported: tuple[Path, Row, Row], assets: Assets) -> None:
    folder, solution, scored = exported
    scene = KittiScenes(folder / "kitti").load(FRAME)
    detector = load_detector("pointpillars")
    theta = torch.tensor([solution[name] for name in POSE], dtype=torch.float64)
    box = object_box(theta, assets.vehicle(SPEC).size_m, scene.ground_z_m)
    points = to_network_frame(torch.from_numpy(scene.points.copy()), scene.ground_z_m)
    with torch.no_grad():
        proposals = detector.proposals(points, window_around(detector, theta, SCORE_RADIUS_M))
    found = detection_score(suppress(proposals, SCORE_FLOOR, SUPPRESSION_IOU), box)
    assert scored["score"] > 0.0 and found == pytest.approx(scored["score"], abs=1e-6)


def test_the_frame_has_every_box_and_the_inserted_one_last(exported: tuple[Path, Row, Row], assets: Assets) -> None:
    folder, solution, _ = exported
    original, _ = assets.scene(SPEC)
    scene = KittiScenes(folder / "kitti").load(FRAME)
    theta = torch.tensor([solution[name] for name in POSE], dtype=torch.float64)
    stated = json.loads((folder / "box.json").read_text())
    box, own = (np.array([stated[which][name] for name in BOX]) for which in ("box", "own_box"))
    wanted = object_box(theta, assets.vehicle(SPEC).size_m, 0.0)
    assert box == pytest.approx(np.array([*wanted[:6], wrapped(theta[3])]))
    expected = np.concatenate((original.labels.boxes, own[None]))
    found = scene.labels.boxes
    assert found[:, :6] == pytest.approx(expected[:, :6], abs=1e-6)
    turned = found[:, 6] - expected[:, 6]
    assert np.abs(np.sin(turned)).max() < 1e-6 and np.cos(turned).min() > 0.999
    assert scene.labels.classes == (*original.labels.classes, "vehicle")
    assert scene.ground_z_m == original.ground_z_m and len(scene.points) == len(original.points)
    stated = json.loads((folder / "boxes.json").read_text())
    assert [row["inserted"] for row in stated["objects"]] == [False] * len(original.labels.boxes) + [True]
    assert stated["objects"][-1]["box"] == json.loads((folder / "box.json").read_text())["own_box"]
    assert stated["ground_z_m"] == original.ground_z_m


def test_headings_are_written_within_half_a_turn(
    exported: tuple[Path, Row, Row], assets: Assets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, export.vehicle_mesh.__name__, partial(export.vehicle_mesh, resolution=33))
    folder, solution, _ = exported
    export_solution(SPEC, solution | {"yaw_rad": solution["yaw_rad"] + 2.0 * math.pi}, assets, tmp_path)
    for name in ("box", "own_box"):
        once, again = (json.loads((of / "box.json").read_text())[name]["heading"] for of in (folder, tmp_path))
        assert again == pytest.approx(once) and abs(again) <= math.pi
    objects = json.loads((tmp_path / "boxes.json").read_text())["objects"]
    assert max(abs(row["box"]["heading"]) for row in objects) <= math.pi


def test_the_coloured_cloud_is_the_scene(exported: tuple[Path, Row, Row]) -> None:
    folder, _, _ = exported
    raw = np.fromfile(folder / "scene.bin", dtype="<f4").reshape(-1, 4)
    cloud, hits = trimesh.load(folder / "scene.ply"), np.load(folder / "hit_mask.npy", allow_pickle=False)
    assert np.abs(np.asarray(cloud.vertices) - raw[:, :3]).max() < 1e-4
    coloured = (np.asarray(cloud.colors)[:, :3] == (213, 94, 0)).all(axis=1)
    assert np.array_equal(coloured, hits) and 0 < hits.sum() < len(hits)
    assert (folder / "kitti" / "training" / "velodyne" / f"{FRAME}.bin").read_bytes() == raw.tobytes()


def test_the_glb_is_the_mesh_in_its_own_frame_standing_upright(exported: tuple[Path, Row, Row], assets: Assets) -> None:
    folder, _, _ = exported
    glb, ply = trimesh.load(folder / "object.glb", force="mesh"), trimesh.load(folder / "object.ply")
    length, width, height = assets.vehicle(SPEC).size_m
    assert glb.extents == pytest.approx((width, height, length), rel=0.1)  # x, y, z of glTF
    assert glb.volume == pytest.approx(ply.volume, rel=1e-4) and glb.volume > 0
    assert np.abs(glb.bounds.mean(axis=0)).max() < 0.2
    points = np.fromfile(folder / "scene.bin", dtype="<f4").reshape(-1, 4)[np.load(folder / "hit_mask.npy"), :3]
    box = json.loads((folder / "box.json").read_text())["box"]
    values = np.array([[box[name] for name in BOX]])
    assert points_in_boxes(points, values, margin_m=0.3).mean() > 0.95


@pytest.mark.parametrize("heading", [-3.0, -1.0, 0.0, 0.7, 2.5, np.pi])
def test_a_label_is_the_inverse_of_reading_it(heading: float) -> None:
    box = np.array([12.0, -3.5, -0.9, 4.4, 1.8, 1.5, heading])
    words = label_line("vehicle", box).split()
    assert len(words) == 15 and words[0] == "Car"
    values = [float(word) for word in words[1:]]
    back = lidar_box(values[7:10], values[10:13], values[13], CALIBRATION)
    assert back[:6] == pytest.approx(box[:6], abs=1e-7) and np.cos(back[6] - heading) == pytest.approx(1.0)
    left, top, right, low = values[3:7]
    assert 0 <= left < right <= 1242 and 0 <= top < low <= 375  # ahead of the camera
    assert label_line("cyclist", box * [-1, 1, 1, 1, 1, 1, 1]).split()[4:8] == ["0.000000000"] * 4  # behind it


def test_a_ground_file_that_is_none_is_refused(exported: tuple[Path, Row, Row], tmp_path: Path) -> None:
    import shutil

    shutil.copytree(exported[0] / "kitti", tmp_path / "kitti")
    path = tmp_path / "kitti" / "training" / "ground" / f"{FRAME}.txt"
    for text, printed in (
        ("-1.7 -1.6", "2 numbers, one height"),
        ("low", "not a finite number"),
        ("1e9", "one height"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=printed):
            KittiScenes(tmp_path / "kitti").load(FRAME)
    path.unlink()
    assert abs(KittiScenes(tmp_path / "kitti").load(FRAME).ground_z_m + 1.73) < 0.35  # estimated, like KITTI's


def test_a_pose_is_exported_where_it_stands(
    pose: TaskResult, assets: Assets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, export.vehicle_mesh.__name__, partial(export.vehicle_mesh, resolution=33))
    (solution,) = (row for row in pose.solutions if row["method"] == "adversarial")
    export_solution(make_spec("pose"), solution, assets, tmp_path)
    stated = json.loads((tmp_path / "box.json").read_text())
    assert stated["vehicle"] == "suv" and stated["drawn_as"] == solution.get("drawn_as")
    assert stated["pose"] == {name: solution[name] for name in POSE}
    assert stated["box"]["x"] == solution["x_m"] and stated["box"]["heading"] == solution["yaw_rad"]


def test_an_export_is_not_replaced_without_a_word(
    exported: tuple[Path, Row, Row], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = exported[0]
    valid_sweeps.write_sweep(tmp_path)
    write_final(tmp_path, read_plan(tmp_path), read_log(tmp_path))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    words = ["export", str(tmp_path), f"task={valid_sweeps.plan().tasks[0].spec.task_id}", "method=adversarial"]
    assert main([*words, f"to={folder}"]) == 2
    assert "scene.bin is there already" in (printed := capsys.readouterr().err) and "overwrite=true" in printed
    assert main([*words, f"to={folder}", "overwrite=yes"]) == 2
    assert "neither true nor false" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in before}


def test_every_file_of_an_export_is_looked_for_and_others_are_not(
    exported: tuple[Path, Row, Row], tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").touch()
    check_no_export(tmp_path)
    for index, name in enumerate(sorted({path.relative_to(exported[0]).parts[0] for path in exported[0].rglob("*")})):
        (tmp_path / str(index)).mkdir()
        (tmp_path / str(index) / name).touch()
        with pytest.raises(InputError, match=name):
            check_no_export(tmp_path / str(index))


def test_a_baseline_is_rendered_again_to_the_bit(shape: TaskResult, assets: Assets) -> None:
    """The rendering uses its task's SDF grid: report, suite and fine-tuning see the scene that was scored."""
    (solution,) = (row for row in shape.solutions if row["method"] == "baseline")
    again = render_solution(SPEC, solution, assets)
    theta = torch.tensor([solution[name] for name in POSE], dtype=torch.float64)
    problem = build_problem(SPEC, assets, theta)
    assert problem.space is not None, "this test says nothing of a task without a grid"
    with torch.no_grad():
        points = problem.insert(problem.code0, theta).points
    assert torch.equal(again.rendering.points, points)
