"""``shift3d evaluate``: its refusals, its completions, and one frame from end to end."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from onnx_files import BOXES, OWN_SOURCE, write_model

from shift3d.cli.commands.detectors.evaluate import COMMAND
from shift3d.cli.main import main
from shift3d.detectors.models.weights import WEIGHTS_FOLDER
from shift3d.scenes.sets import StreetScenes
from shift3d.training.provenance import write_provenance


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "detector= is missing"),
        (["detector=pointpilars"], "pointpilars"),
        (["detector=own"], "module= is missing. Give module=FILE.py"),
        (["detector=own", "module=absent.py"], "absent.py: no such file. Check module="),
        (["detector=onnx"], "file= is missing. Give file=FILE.onnx"),
        (["detector=pointpillars", "scenes=moon"], "scenes='moon' is unknown"),
        (["detector=pointpillars", "scenes=kitti"], "root= is missing"),
        (["detector=pointpillars", "root=x"], "root= means nothing for scenes=street"),
        (["detector=pointpillars", "scenes=kitti", "root=x", "split=val"], "split= means nothing for scenes=kitti"),
        (["detector=pointpillars", "scenes=kitti", "root=nowhere"], "no folder training/velodyne"),
        (["detector=pointpillars", "scenes=openpcdet"], "Give root=PATH, the folder that holds points/ and labels/"),
        (
            ["detector=pointpillars", "scenes=openpcdet", "root=x", "sensor=hdl64"],
            "sensor= means nothing for scenes=open",
        ),
        (["detector=pointpillars", "scenes=openpcdet", "root=x", "sensor_m=up"], "sensor_m='up' is no position"),
        (["detector=pointpillars", "scenes=openpcdet", "root=x", "sensor_m=[1]"], "Change it with sensor_m=VALUE"),
        (["detector=pointpillars", "scenes=openpcdet", "root=nowhere"], "no folder points/"),
        (["detector=pointpillars", "split=holdout"], "split='holdout' is unknown"),
        (["detector=pointpillars", "count=0"], "count='0' is not a whole number from 1"),
        (["detector=pointpillars", "count=2000000"], "count='2000000' is not a whole number from 1 to 1000000"),
        (["detector=pointpillars", "workers=two"], "workers='two' is not a whole number"),
        (["detector=pointpillars", "score_threshold=1.5"], "score_threshold='1.5' is not in [0, 1)"),
        (["detector=pointpillars", "weights=nowhere.safetensors"], "nowhere.safetensors"),
        (["model=pointpillars"], "Give model=sdf, or detector=pointpillars scenes=street"),
        (["model=sdf", "count=3"], "cannot read 'count=3'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_used_is_one_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    if not any(word.startswith("model=") for word in words):
        words = [*words, f"out={tmp_path / 'out'}"]
    assert main(["evaluate", *words]) == 2
    captured = capsys.readouterr()
    assert message in captured.err and len(captured.err.strip().splitlines()) == 1
    assert not (tmp_path / "out" / "metrics.parquet").exists()


def test_ones_own_detector_and_its_onnx_file_are_evaluated_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One function as a Python file and as a graph gives the same detections, with boxes on the scene's ground."""
    (tmp_path / "mine.py").write_text(OWN_SOURCE)
    (tmp_path / "mine.json").write_text("[]")  # a user's file, not the project's provenance
    files = {"own": f"module={tmp_path / 'mine.py'}", "onnx": f"file={write_model(tmp_path / 'mine.onnx')}"}
    for name, file in files.items():
        words = ["evaluate", f"detector={name}", file, "sensor=hdl64", "count=2", f"out={tmp_path / name}"]
        assert main(words) == 0
        assert f"{name} on street-hdl64-test: 2 scenes," in capsys.readouterr().out
    tables = [pd.read_parquet(tmp_path / name / "detections.parquet") for name in files]
    own, onnx = (table.drop(columns="detector") for table in tables)
    pd.testing.assert_frame_equal(own, onnx, atol=1e-6)
    ground_z_m = [scene.ground_z_m for scene in map(StreetScenes("hdl64", count=2).load, own["scene"])]
    assert len(own) == 4
    height = {round(float(x), 3): z for x, _, z in BOXES[:, :3]}
    expected = [ground + height[round(x, 3)] for x, ground in zip(own["x_m"], ground_z_m)]
    np.testing.assert_allclose(own["z_m"], expected, atol=1e-6)
    (tmp_path / "mine.py").write_text(OWN_SOURCE + "\n")
    words = ["evaluate", "detector=own", files["own"], "sensor=hdl64", "count=2", f"out={tmp_path / 'own'}"]
    assert main(words) == 2 and "holds another evaluation" in capsys.readouterr().err


def test_ones_own_frames_have_their_own_mounting_height(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Labels at the detector's boxes give an AP of 1. With another height of the ground the boxes miss them in 3D."""
    ground = np.random.default_rng(0).uniform(-30, 30, (20_000, 2))
    on_boxes = np.repeat(BOXES[:, :3], 10, axis=0) - [0.0, 0.0, 1.1]
    points = np.concatenate((np.column_stack((ground, np.full(len(ground), -1.1))), on_boxes)).astype(np.float32)
    for part in ("points", "labels"):
        (tmp_path / "frames" / part).mkdir(parents=True)
    np.save(tmp_path / "frames" / "points" / "a.npy", points)
    lines = [" ".join(map(str, [x, y, z - 1.1, *rest, "Car"])) for x, y, z, *rest in BOXES.tolist()]
    (tmp_path / "frames" / "labels" / "a.txt").write_text("\n".join(lines))
    (tmp_path / "mine.py").write_text(OWN_SOURCE)
    words = ["evaluate", "detector=own", f"module={tmp_path / 'mine.py'}", "scenes=openpcdet"]
    for name, more, expected in (("own", [], 1.0), ("other", ["ground_z_m=-3"], 0.0)):
        out = tmp_path / name
        assert main([*words, f"root={tmp_path / 'frames'}", f"out={out}", *more]) == 0
        assert "own on openpcdet: 1 scene," in capsys.readouterr().out
        metrics = pd.read_parquet(out / "metrics.parquet")
        rows = metrics[(metrics["view"] == "3D") & (metrics["num_truth"] == 2)]
        np.testing.assert_allclose(rows.loc[rows["metric"] == "AP", "value"], expected, atol=1e-9)
        assert len(rows)
    for other in ("ground_z_m=-3", "sensor_m=[0,0,1]", "reflectance_max=255"):
        assert main([*words, f"root={tmp_path / 'frames'}", f"out={tmp_path / 'own'}", other]) == 2
        assert "another evaluation" in capsys.readouterr().err, other
    (tmp_path / "frames" / "labels" / "a.txt").write_text("")
    assert main([*words, f"root={tmp_path / 'frames'}", f"out={tmp_path / 'empty'}"]) == 0
    assert "No scene has a labelled vehicle" in capsys.readouterr().out


def test_completion() -> None:
    assert COMMAND.complete is not None
    assert COMMAND.complete("scenes=") == ["scenes=street", "scenes=kitti", "scenes=openpcdet"]
    assert "detector=pointpillars" in COMMAND.complete("detector=")
    assert COMMAND.complete("s") == [
        "scenes=",
        "sensor=",
        "split=",
        "sensor_m=",
        "sensor_height_m=",
        "score_threshold=",
    ]
    assert COMMAND.complete("root=") == []


def test_one_real_frame_and_the_same_command_again(
    real_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = real_data("kitti") / "training"
    name = min(path.stem for path in (frames / "label_2").glob("*.txt") if "Car" in path.read_text())
    for part, suffix in (("velodyne", "bin"), ("calib", "txt"), ("label_2", "txt")):
        (tmp_path / "training" / part).mkdir(parents=True)
        (tmp_path / "training" / part / f"{name}.{suffix}").symlink_to(frames / part / f"{name}.{suffix}")
    out = tmp_path / "out"
    words = ["evaluate", "detector=pointpillars", "scenes=kitti", f"root={tmp_path}", "count=1", f"out={out}"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "pointpillars on kitti: 1 scene," in printed and "moderate" in printed
    assert "was trained on" not in printed
    metrics = pd.read_parquet(out / "metrics.parquet")
    assert set(metrics["protocol"]) == {"waymo", "waymo_strict", "kitti", "shift3d"}
    assert metrics["value"].dropna().between(0.0, 1.0).all() and metrics["value"].notna().any()
    before = {path.name: path.read_bytes() for path in out.glob("*.*")}
    assert main(words) == 0  # from stored results: the times are those of the first run
    assert {path.name: path.read_bytes() for path in out.glob("*.*")} == before
    assert json.loads(before["spec.json"])["detector"] == "pointpillars"
    assert main([*words, "score_threshold=0.2"]) == 2
    assert "holds another evaluation" in capsys.readouterr().err
    own = Path(shutil.copy(WEIGHTS_FOLDER / "sst_small.safetensors", tmp_path / "own.safetensors"))
    write_provenance(own, {"scenes": {"dataset": "kitti", "count": 1, "names": [name]}})
    words[1] = "detector=sst_small"  # quicker
    assert main([*words[:-1], f"weights={own}", f"out={tmp_path / 'other'}"]) == 0
    same = "was trained on frames with the names of 1 of these 1 scene. If they are the same frames, expect a lower AP"
    assert f"warning: {own} {same}" in capsys.readouterr().out
