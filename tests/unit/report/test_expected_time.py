"""What a plan will take: by earlier tasks of the same settings, scaled to other ones, less what is done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from valid_sweeps import _catalogue, plan, write_sweep

from shift3d.config.compose import compose_sweep
from shift3d.errors import InputError
from shift3d.render.called_for import measured_worth
from shift3d.report.expected import SHIPPED, expected, expected_lines
from shift3d.store.log import CommitLog
from shift3d.store.tables import table_from_rows
from shift3d.sweep.folder import open_folder
from shift3d.sweep.plan import Plan, make_plan
from shift3d.sweep.worker import attempt_row


def plan_of(*words: str) -> Plan:
    return make_plan(compose_sweep("smoke", ["vehicle=suv", *words]), _catalogue)[0]


def ran(folder: Path, done: Plan, seconds: float) -> Path:
    """A sweep's folder whose tasks took so long, each after a failed try of one second."""
    open_folder(folder, done)
    log = CommitLog(folder, done.spec_hash)
    for task_id in done.tasks.ids.to_pylist():
        tries = [attempt_row(task_id, 1, "failed", 0.0, 1.0), attempt_row(task_id, 2, "done", 1.0, seconds - 1.0)]
        log.commit((task_id,), (), {"attempts": table_from_rows("attempts", tries)})
    return folder


def test_by_earlier_tasks_of_the_same_settings(tmp_path: Path) -> None:
    folder = ran(tmp_path / "earlier", plan_of("mode=shape", "scene=north"), 6.0)
    found = expected(plan_of("mode=shape").tasks, [folder])
    assert (found.tasks, found.guessed) == (2, 0) and found.seconds == pytest.approx(12.0)
    assert f"1 tasks that ran in {folder}" in found.source


def test_other_settings_are_scaled_by_the_figures_that_ship(tmp_path: Path) -> None:
    """The same tasks at another number of steps, and in fog: in the proportion of the figures, counted as guessed."""
    small, large = plan_of("mode=shape"), plan_of("mode=shape", "attack.steps=31")
    foggy = plan_of("mode=shape", "effects=fog", "effects.visibility_m=30")
    folder = ran(tmp_path / "earlier", small, 6.0)
    for other in (large, foggy):
        found, by_figures = expected(other.tasks, [folder]), expected(other.tasks, []).seconds
        assert found.guessed == 2
        assert found.seconds == pytest.approx(12.0 * by_figures / expected(small.tasks, []).seconds)
        assert found.seconds > 12.0


def test_the_figures_that_ship() -> None:
    values = json.loads(SHIPPED.read_text())
    pose = plan_of("mode=pose", "accuracy=standard", "attack=paper")
    found = expected(pose.tasks, [])
    assert found.seconds == pytest.approx(2 * values["pose"]["seconds"], rel=0.05) and found.guessed == 2
    foggy = expected(
        plan_of("mode=pose", "accuracy=standard", "attack=paper", "effects=fog", "effects.visibility_m=30").tasks, []
    )
    more = 2 * values["pose"]["renderings"] * measured_worth()["fog"].milliseconds / 1e3
    assert foggy.seconds - found.seconds == pytest.approx(more, rel=0.05)
    assert values["source"] in found.source


def test_what_is_done_is_not_counted(tmp_path: Path) -> None:
    north, both = plan_of("mode=shape", "scene=north"), plan_of("mode=shape")
    folder = ran(tmp_path / "earlier", north, 36.0)
    lines = expected_lines(both, tmp_path / "out", [folder], [], 4).splitlines()
    assert lines[0] == "1 of 2 tasks are done already"
    assert lines[1] == "expected: 1 tasks of 36 s: 36 s with 4 workers (runner.workers=N), 0.01 core-hours"
    assert expected_lines(north, folder, [], [], 1).endswith("nothing is left to run")


def test_a_folder_that_has_run_nothing_says_nothing(tmp_path: Path) -> None:
    open_folder(tmp_path / "out", plan())
    assert "the figures that ship" in expected_lines(plan(), tmp_path / "out", [], [], 2)
    with pytest.raises(InputError, match="is not the output folder of a sweep"):
        expected_lines(plan(), tmp_path / "out", [], [tmp_path / "none"], 2)
    write_sweep(tmp_path / "finished")
    (tmp_path / "finished" / "plan.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"plan\.parquet"):
        expected_lines(plan_of("mode=pose"), tmp_path / "out", [], [tmp_path / "finished"], 2)
