"""Effects in real tasks: none without a call for them, and the same bytes after any earlier task."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections import OrderedDict
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from short_tasks import STREET, make_spec

from shift3d.effects.applicability import NEEDS
from shift3d.scenes.kitti.files import read_points
from shift3d.settings.schema.scenes import scene_config, scene_set
from shift3d.task.assets import Assets
from shift3d.task.exchange import TaskResult
from shift3d.task.follow_ups import export
from shift3d.task.problem import build_problem
from shift3d.task.run import run_task
from shift3d.task.scoring import score_points
from shift3d.task.spec import AttackSpec, TaskSpec

RICH = STREET | {
    "count": 1,
    "sensor_model": True,
    "range_image": True,
    "returns": 2,
    "ego_speed_m_s": 15.0,
    "motion_compensated": True,
}
WEATHER = {"visibility_m": 80.0, "rain_mm_h": 20.0, "snow_mm_h": 0.5, "object_speed_m_s": 5.0}

PLAN_AND_RUN = """
import json, sys
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.sweep.planning.plan import make_plan
from shift3d.task.assets import load_assets
from shift3d.task.run import run_task

words = ["scenes.count=1", "scenes.sensor=hdl64", "vehicle=suv", "mode=pose", "attack=short", "attack.steps=0"]
words += ["naturalness=none", "attack.random_replicates=0"]
plans = [make_plan(compose_sweep("default", [*words, f"effects={e}"]), read_catalogue)[0] for e in ("auto", "none")]
(task,), (paper,) = (plan.tasks for plan in plans)
result = run_task(task.spec, load_assets(plans[0].assets[0]))
print(json.dumps({
    "same": task.spec == paper.spec,
    "score": result.scores[0]["score"],
    "effects": result.scores[0]["effects"],
    "stages": sorted({row["stage"] for row in result.timings}),
    "imported": sorted(name for name in sys.modules if name.startswith("shift3d.effects")),
}))
"""


def test_a_dry_scene_with_one_return_runs_occlusion_alone_and_imports_no_effect() -> None:
    """Planned with effects=auto, the task equals that of effects=none, and no effect's code is even read."""
    done = subprocess.run([sys.executable, "-c", PLAN_AND_RUN], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["same"] and found["effects"] == [] and 0.0 <= found["score"] <= 1.0
    choosing = ["shift3d.effects", "shift3d.effects.applicability"]
    assert found["imported"] == choosing and not any("effect" in stage for stage in found["stages"])


@pytest.fixture(scope="module")
def rich(assets: Assets) -> Assets:
    """The same assets with other scenes."""
    return dataclasses.replace(assets, scenes=scene_set(scene_config(RICH)), poses={}, _scenes=OrderedDict())


def rich_spec(assets: Assets, *effects: str) -> TaskSpec:
    attack = AttackSpec(steps=1, noise_replicates=0, random_replicates=0)
    spec = make_spec(scene=assets.scenes.names()[0], effects=effects, effect_settings=WEATHER)
    return dataclasses.replace(spec, attack=attack)


@pytest.fixture(scope="module")
def everything(rich: Assets) -> TaskResult:
    return run_task(rich_spec(rich, *NEEDS), rich)


def test_every_effect_at_once_and_again_after_another_task(rich: Assets, everything: TaskResult) -> None:
    other = rich_spec(rich, "range_noise")
    run_task(dataclasses.replace(other, mode="pose", attack=dataclasses.replace(other.attack, steps=0)), rich)
    again = run_task(rich_spec(rich, *reversed(NEEDS)), rich)
    assert [row | {"effects": None} for row in again.scores] == [row | {"effects": None} for row in everything.scores]
    assert everything.scores[0]["effects"] == list(NEEDS) and everything.scores[0]["non_finite"] == 0


def test_time_is_told_by_effect(everything: TaskResult) -> None:
    acting = {name for name in NEEDS if name not in ("origins", "no_return_beams", "rolling_shutter")}
    stages = {row["stage"] for row in everything.timings if row["method"] == "baseline"}
    assert {f"effect_{name}" for name in acting} | {"effects_once", "render"} <= stages
    assert all(row["milliseconds"] >= 0.0 for row in everything.timings)


def test_a_written_scene_with_effects_gets_the_same_score(
    rich: Assets, everything: TaskResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, export.vehicle_mesh.__name__, partial(export.vehicle_mesh, resolution=33))
    spec = rich_spec(rich, *NEEDS)
    solution, row = everything.solutions[-1], everything.scores[-1]
    export.export_solution(spec, solution, rich, tmp_path)
    points, _ = read_points(tmp_path / "scene.bin")
    hits = np.load(tmp_path / "hit_mask.npy")
    assert len(hits) == len(points) and int(hits.sum()) == row["object_points"] > 0
    assert float(np.linalg.norm(points, axis=1).max()) < 1e3  # lost returns are not written
    theta = torch.tensor([solution[n] for n in ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")]).double()
    problem = build_problem(spec, rich, theta)
    (answer,) = score_points(problem, torch.from_numpy(points), theta, 5.0, {"p": problem.detector}).values()
    assert answer.score == pytest.approx(row["score"], abs=1e-6)
