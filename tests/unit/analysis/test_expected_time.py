"""Expected time of a plan: from earlier tasks of the same settings, scaled to other settings, less finished tasks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pandas as pd
import pytest
from scripts.shipped import measured_parts
from valid_sweeps import catalogue, plan, write_sweep

from shift3d.analysis.forecast import TaskPartTimes, expected, limit_line, run_time_lines, shipped_parts
from shift3d.cli.main import main
from shift3d.effects.applicability import measured_impact
from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.config import LocalRunnerConfig, RayRunnerConfig
from shift3d.store.log import CommitLog
from shift3d.store.tables import table_from_rows
from shift3d.sweep import drive
from shift3d.sweep.execution.worker import attempt_row
from shift3d.sweep.planning.folder import open_folder
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.task.spec import AttackSpec, TransferScene


def plan_of(*words: str) -> Plan:
    return make_plan(compose_sweep("smoke", ["vehicle=suv", *words]), catalogue)[0]


def ray(**settings: float) -> RayRunnerConfig:
    runner = validate(compose_sweep("smoke", []).base, "test").runner
    assert isinstance(runner, RayRunnerConfig)
    return runner.model_copy(update=settings)


def ran(folder: Path, done: Plan, seconds: float) -> Path:
    """Write a sweep's folder whose tasks took this long, each after a failed try of one second."""
    open_folder(folder, done)
    log = CommitLog(folder, done.spec_hash)
    for task_id in done.tasks.ids.to_pylist():
        tries = [attempt_row(task_id, 1, "failed", 0.0, 1.0), attempt_row(task_id, 2, "done", 1.0, seconds - 1.0)]
        log.commit((task_id,), (), {"attempts": table_from_rows("attempts", tries)})
    return folder


def test_by_earlier_tasks_of_the_same_settings(tmp_path: Path) -> None:
    folder = ran(tmp_path / "earlier", plan_of("mode=shape", "scene=north"), 6.0)
    found = expected(plan_of("mode=shape").tasks, [folder])
    assert found.guessed == 0 and found.seconds == pytest.approx(12.0)
    assert f"1 task that ran in {folder}" in found.source


def test_scenes_without_a_place_do_not_say_how_long_a_search_takes(tmp_path: Path) -> None:
    done = plan_of("mode=shape")
    folder = ran(tmp_path / "earlier", done, 6.0)
    nowhere = done.tasks[0].spec
    row = {name: getattr(nowhere, name) for name in ("task_id", "vehicle", "scene", "dataset", "mode", "detector")}
    row |= {
        "sweep": "smoke",
        "accuracy": "draft",
        "search": "descent",
        "alpha": 0.01,
        "effects": [],
        "method": "baseline",
        "replicate": 0,
    }
    scores = table_from_rows("scores", [{**row, "scored_by": "pointpillars", "status": "no_placement"}])
    CommitLog(folder, done.spec_hash).commit((), (), {"scores": scores})
    assert f"1 task that ran in {folder}" in expected(done.tasks, [folder]).source


def test_other_settings_are_scaled_by_the_figures_that_ship(tmp_path: Path) -> None:
    """The tasks have another number of steps and fog: the shipped figures scale them, and they count as guessed."""
    small, large = plan_of("mode=shape"), plan_of("mode=shape", "attack.steps=31")
    foggy = plan_of("mode=shape", "effects=fog", "effects.visibility_m=30")
    folder = ran(tmp_path / "earlier", small, 6.0)
    for other in (large, foggy):
        found, by_figures = expected(other.tasks, [folder]), expected(other.tasks, []).seconds
        assert found.guessed == 2
        assert found.seconds == pytest.approx(12.0 * by_figures / expected(small.tasks, []).seconds)
        assert found.seconds > 12.0


def test_the_figures_that_ship() -> None:
    parts = shipped_parts()
    pose = ("mode=pose", "accuracy=standard", "attack=paper")
    found = expected(plan_of(*pose).tasks, [])
    step = parts.step_ms["pose"] + parts.descent_ms["pointpillars"]
    scored = parts.scored_ms["pose"] + parts.score_ms["pointpillars"]
    assert found.seconds == pytest.approx(2 * (parts.once_ms["pose"] + 41 * step + 3 * scored) / 1e3)
    assert found.guessed == 2 and parts.source in found.source
    foggy = expected(plan_of(*pose, "effects=fog", "effects.visibility_m=30").tasks, [])
    more = 2 * (41 + 3) * measured_impact()["fog"].milliseconds / 1e3
    assert foggy.seconds - found.seconds == pytest.approx(more)


def test_a_task_by_its_parts() -> None:
    """10 steps and the start are 11 steps; with two random shapes and three with noise they render 7 objects."""
    parts = TaskPartTimes(
        "by hand", "standard", {"shape": 1e6, "pose": 0.0}, {"shape": 1e4}, {"shape": 1e3},
        {"pointpillars": 100.0, "sst": 200.0}, {"pointpillars": 1.0, "sst": 2.0}, 0.5,
    )  # fmt: skip
    attack = AttackSpec(steps=10, random_replicates=2, noise_replicates=3)
    spec = replace(plan_of("mode=shape").tasks[0].spec, attack=attack)
    assert parts.of(spec) == 1e6 + 11 * 10_100 + 7 * 1001
    assert parts.of(replace(spec, scored_by=("sst",))) == 1e6 + 11 * 10_100 + 7 * 1003
    assert parts.of(replace(spec, detector="sst", scored_by=("pointpillars",))) == 1e6 + 11 * 10_200 + 7 * 1003
    assert parts.of(replace(spec, detector="ours", scored_by=())) == 1e6 + 11 * 10_200 + 7 * 1002
    other = TransferScene("north", "hash")
    assert parts.of(replace(spec, transfer_scenes=(other, other))) == 1e6 + 11 * 10_100 + 7 * 1001 + 2 * (
        0.5 + 2 * 1001
    )


def test_what_stands_beside_a_search_counts() -> None:
    """Random draws take as many renderings as the search; a universal shape takes one per step and scene."""
    parts = TaskPartTimes(
        "by hand", "standard", {"shape": 0.0, "pose": 7.0}, {"shape": 10.0, "pose": 20.0}, {"shape": 1e3, "pose": 2e3},
        {"pointpillars": 0.0}, {"pointpillars": 0.0}, 0.0,
    )  # fmt: skip
    attack = AttackSpec(steps=10, random_replicates=0, noise_replicates=0)
    spec = replace(plan_of("mode=shape").tasks[0].spec, attack=attack)
    assert parts.of(spec) == 11 * 10 + 2 * 1e3
    assert parts.of(replace(spec, attack=replace(attack, random_search=1))) == 22 * 10 + 3 * 1e3
    assert parts.of(replace(spec, attack=replace(attack, edit="chassis.height_m:1"))) == 11 * 10 + 3 * 1e3
    scenes = tuple(TransferScene(name, "hash") for name in "abc")
    universal = replace(spec, attack=replace(attack, search_scenes=2), transfer_scenes=scenes)
    assert parts.of(universal) == 3 * 11 * 10 + 2 * 1e3 + 2 * 1e3
    both = replace(spec, mode="shape_pose")
    assert parts.of(both) == 7 + 11 * 20 + 2 * 2e3, "a mode that was not measured takes as long as the slowest"


def test_scenes_that_a_shape_is_put_into_count() -> None:
    """The smoke sweep's set has two streets: none or the other one, and one of each in a sweep over both."""
    one, both = plan_of("mode=shape", "attack.transfer_scenes=1"), plan_of("mode=shape", "attack.transfer_scenes=0,1")
    none, parts = expected(plan_of("mode=shape").tasks, []).seconds, shipped_parts()
    each = parts.scored_ms["shape"] + parts.score_ms["pointpillars"]
    more = 2 * (parts.placement_ms + 2 * each) / 1e3
    assert expected(one.tasks, []).seconds == pytest.approx(none + more)
    assert expected(both.tasks, []).seconds == pytest.approx(2 * none + more)


def test_earlier_tasks_with_fewer_transfers_are_scaled(tmp_path: Path) -> None:
    folder = ran(tmp_path / "earlier", plan_of("mode=shape"), 6.0)
    one = plan_of("mode=shape", "attack.transfer_scenes=1")
    found = expected(one.tasks, [folder])
    none = expected(plan_of("mode=shape").tasks, []).seconds
    assert found.guessed == 2 and found.seconds == pytest.approx(12.0 * expected(one.tasks, []).seconds / none)


def test_parts_of_tasks_from_their_timings() -> None:
    """Two shape tasks against one detector, also scored by another one, and a pose task are computed by hand."""
    tasks = [("a", "shape"), ("b", "shape"), ("c", "pose")]
    scores = pd.DataFrame([(task, mode, "one", "standard") for task, mode in tasks for _ in range(3)])
    scores.columns = ["task_id", "mode", "detector", "accuracy"]
    timings = []
    for task, mode in tasks:
        slower = 2.0 if task == "b" else 1.0
        for stage, milliseconds in (("render", 60.0), ("constraints", 3.0), ("detector", 30.0), ("backward", 12.0)):
            timings.append((task, "adversarial", stage, slower * milliseconds, 6))
        for method in ("baseline", "random"):
            timings.append((task, method, "render", 7.0, 1))
            timings.append((task, method, "constraints", 1.0, 1))
            timings.append((task, method, "detector", 20.0, 1))
            timings.append((task, method, "scored_by_two", 50.0, 1))
        timings.append((task, "baseline", "placement", 100.0, 1))
        timings.append((task, "adversarial", "total", 1e6, 1))
        if mode == "shape":
            timings += [(task, "adversarial", "mesh", 40.0, 1), (task, "adversarial", "transfers", 90.0, 3)]
    columns = ["task_id", "method", "stage", "milliseconds", "calls"]
    parts = measured_parts(scores, pd.DataFrame(timings, columns=columns), "three tasks")
    assert parts.once_ms == {"shape": 140.0, "pose": 100.0}
    assert parts.step_ms == {"shape": 15.8, "pose": 10.5}  # of (60 + 3) / 6, twice that in one of two tasks
    assert parts.descent_ms == {"one": 9.3}  # of (30 + 12) / 6 in two tasks, twice that in one
    assert parts.scored_ms == {"shape": 8.0, "pose": 8.0}
    assert parts.score_ms == {"one": 20.0, "two": 50.0}
    assert (parts.placement_ms, parts.accuracy, parts.source) == (100.0, "standard", "three tasks")
    with pytest.raises(InputError, match="of the accuracies draft, standard"):
        measured_parts(
            scores.assign(accuracy=["draft"] * 3 + ["standard"] * 6), pd.DataFrame(timings, columns=columns), ""
        )


def test_what_is_done_is_not_counted(tmp_path: Path) -> None:
    north, both = plan_of("mode=shape", "scene=north"), plan_of("mode=shape")
    folder = ran(tmp_path / "earlier", north, 36.0)
    lines = run_time_lines(both, tmp_path / "out", [folder], [], ray(workers=4)).splitlines()
    assert lines[0] == "1 of 2 tasks are done already"
    assert lines[1] == "expected run time: 36 s with 4 workers (runner.workers=N), 0.01 core-hours, for 1 task of 36 s"
    assert run_time_lines(north, folder, [], [], ray(workers=1)).endswith("nothing is left to run")


def test_what_was_given_up_on_is_not_counted_but_said(tmp_path: Path) -> None:
    both, out = plan_of("mode=shape"), tmp_path / "out"
    open_folder(out, both)
    CommitLog(out, both.spec_hash).commit((), (both.tasks[0].spec.task_id,), {})
    lines = run_time_lines(both, out, [], [], ray(workers=1)).splitlines()
    assert lines[0] == "1 quarantined task stays out: --retry-quarantined runs it again"
    assert ", for 1 task of " in lines[1]


def test_a_folder_that_has_run_nothing_says_nothing(tmp_path: Path) -> None:
    open_folder(tmp_path / "out", plan())
    assert "the shipped times" in run_time_lines(plan(), tmp_path / "out", [], [], ray(workers=2))
    with pytest.raises(InputError, match="is not the output folder of a sweep"):
        run_time_lines(plan(), tmp_path / "out", [], [tmp_path / "none"], ray(workers=2))
    write_sweep(tmp_path / "finished")
    (tmp_path / "finished" / "plan.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"plan\.parquet"):
        run_time_lines(plan_of("mode=pose"), tmp_path / "out", [], [tmp_path / "finished"], ray(workers=2))


def test_a_time_limit_below_twice_the_slowest_task_is_reported_with_one_that_suits(tmp_path: Path) -> None:
    both, limit = plan_of("mode=shape,pose"), ray(workers=1)
    shape, pose = (expected(plan_of(f"mode={mode}").tasks, []).longest_s for mode in ("shape", "pose"))
    assert expected(both.tasks, []).longest_s == max(shape, pose)
    earlier = ran(tmp_path / "earlier", plan_of("mode=shape,pose", "scene=north"), 1000.0)
    *_, line = run_time_lines(both, None, [], [earlier], limit).splitlines()
    assert line.startswith("a task is expected to take 16.7 min; the driver stops a task after 30 min")
    assert line.endswith("(runner.task_timeout_s=1800): give runner.task_timeout_s=4020")
    assert limit_line(900.0, limit) == limit_line(1e9, ray(task_timeout_s=None)) == ""  # type: ignore[arg-type]
    local = LocalRunnerConfig(kind="local", commit_seconds=2.0, abort_after=None, abort_share=None)
    assert limit_line(1e9, local) == ""


@pytest.mark.parametrize("command", [["plan", "smoke"], ["sweep", "smoke"]])
def test_a_plan_and_the_start_of_a_sweep_report_a_time_limit_too_low(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drive, "run_sweep", Mock(side_effect=InputError("it starts")))
    words = ["vehicle=suv", "mode=pose", "scenes.count=1", "tracking=none"]
    main([*command, *words, "accuracy=paper", "attack=paper"])
    assert "give runner.task_timeout_s=" in capsys.readouterr().out
    main([*command, *words])
    assert "task_timeout_s" not in capsys.readouterr().out
