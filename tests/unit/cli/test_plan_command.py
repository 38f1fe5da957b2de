"""``shift3d plan``: the summary first, the list on request, and the refusals of the sweep itself."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import valid_frames
from onnx_files import write_model

from shift3d.cli.main import main
from shift3d.scenes.sets import StreetScenes
from shift3d.settings.catalogue import scene_entries

ONE = ["vehicle=suv", "mode=shape", "attack.lambda=1"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_summary_comes_first_and_the_list_is_folded(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "plan", "default", "scenes.count=2", *ONE]) == 0
    folded = capsys.readouterr().out.splitlines()
    assert folded[0].startswith("sweep default: 2 tasks") and folded[-1] == "to list every task with its id: --tasks"
    assert main(["plan", "default", "scenes.count=2", *ONE, "--tasks"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[: len(folded) - 1] == folded[:-1]
    assert [line.split()[2] for line in listed[-2:]] == StreetScenes("mixed", count=2).names()


def test_time_is_that_of_the_cpus_that_this_process_may_use(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert main(["plan", "default", "scenes.count=2", *ONE]) == 0
    assert " with 1 worker (runner.workers=N)" in capsys.readouterr().out
    assert main(["plan", "default", "scenes.count=2", *ONE, "job=ray_cluster"]) == 0
    unknown = " with 1 worker (the CPUs of this machine, not of the cluster: runner.workers=N)"
    assert unknown in capsys.readouterr().out
    assert main(["plan", "default", "scenes.count=8", *ONE, "job=ray_cluster", "runner.workers=8"]) == 0
    assert " with 8 workers (runner.workers=N)" in capsys.readouterr().out


def test_places_of_each_scene_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "default", "scenes.count=2", *ONE, "--places", "attack.placement.attempts=20"]) == 0
    printed = capsys.readouterr().out
    assert "places for a car, 20 draws per scene:" in printed
    for name in StreetScenes("mixed", count=2).names():
        assert f"  {name}: " in printed
    assert printed.count(" of 20 free; ") == 2


def test_weathers_that_are_printed_together_have_data_sets_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["vehicle=suv", "mode=pose", "scenes.count=2", "scenes.sensor=hdl64"]
    assert main(["plan", "default", *words, "scenes.weather=rain,fog", "attack.steps=5,10"]) == 0
    printed = capsys.readouterr().out
    assert "AUCs average over attack.steps: no table column separates their values" in printed
    assert "AUCs average over scenes.weather: the column dataset separates their values" in printed


def test_named_frames_that_the_count_leaves_out_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    valid_frames.write_frame(tmp_path)
    for path in [*tmp_path.glob("training/*/000007.*")]:
        shutil.copy(path, path.with_stem("000008"))
    words = [*ONE, "scenes=kitti", f"scenes.root={tmp_path}", "scenes.names=['000007','000008']"]
    assert main(["plan", "default", *words, "scenes.count=1"]) == 0
    assert "1 of 2 named scenes: scenes.count=1" in capsys.readouterr().out
    assert main(["plan", "default", *words, "scenes.count=2"]) == 0
    assert "named scenes" not in capsys.readouterr().out


def test_a_plan_says_that_an_onnx_file_has_no_original(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_model(tmp_path / "mine.onnx")
    onnx = ["detector=onnx", "detector.file=mine.onnx", "detector.scored_by=[]", "attack.search=evolution"]
    assert main(["plan", "default", *ONE, *onnx]) == 0
    assert "mine.onnx: scores are compared with no original" in capsys.readouterr().out
    assert main(["plan", "default", *ONE, *onnx, "detector.original=pointpillars"]) == 0
    assert "compared" not in capsys.readouterr().out, "the sweep compares, not the plan"


def test_a_plan_of_many_streets_makes_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(scene_entries, "user_cache", lambda: tmp_path / "cache")
    monkeypatch.setattr(StreetScenes, "load", lambda self, name: pytest.fail(f"{name} was made"))
    words = ["scenes.count=500", "scenes.sensor_model=true", "effects.rain_mm_h=10", *ONE]
    assert main(["sweep", "plan", "default", *words]) == 0
    printed = capsys.readouterr().out
    assert "500 tasks" in printed and "500 of 500" in printed and "outputs/default-HASH" in printed


def test_a_dry_run_is_a_plan(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "default", "scenes.count=1", *ONE, "--dry-run"]) == 0
    dry = capsys.readouterr().out
    assert main(["sweep", "plan", "default", "scenes.count=1", *ONE]) == 0
    assert capsys.readouterr().out == dry


def test_tasks_are_listed_of_plans_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "default", "--tasks"]) == 2
    assert "sweep plan NAME --tasks" in capsys.readouterr().err


def test_a_plan_does_without_what_its_tasks_need() -> None:
    heavy = ("shift3d.task.run", "shift3d.task.assets", "trimesh", "ray", "mlflow")
    code = (
        "import sys\nfrom shift3d.cli.main import main\nassert main(['plan', 'smoke', 'tracking=none']) == 0\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
