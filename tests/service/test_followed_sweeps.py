"""Follow-ups of a sweep whose quarantined tasks were run again later."""

from __future__ import annotations

import dataclasses
import os
import signal
from pathlib import Path

import cheap_task
import pytest

from shift3d.cli.commands import sweep
from shift3d.cli.main import parse
from shift3d.errors import InputError
from shift3d.settings.schema.config import LocalRunnerConfig
from shift3d.store.resolve import as_location
from shift3d.sweep.follow_up import follow_up, follow_up_kind, solved_tasks, verify_sweep
from shift3d.task.exchange import TaskResult
from shift3d.task.spec import TaskSpec

WORDS = ["sweep", "default", "vehicle=suv,coupe", "mode=pose", "scenes.count=2", "tracking=none", "runner=local"]


def test_a_follow_up_of_fewer_solutions_is_to_be_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the folder and its state, and does not suggest to remove anything of the sweep itself."""
    monkeypatch.setenv("SHIFT3D_TEST_FAILS", "coupe/street_001")
    words = [*WORDS, "runner.abort_share=null", f"out={tmp_path / 'out'}"]
    assert sweep.run_with(parse(words), cheap_task.KIND) == 3
    folder, runner = (
        as_location(tmp_path / "out"),
        LocalRunnerConfig(kind="local", commit_seconds=0.0, abort_after=None, abort_share=None),
    )
    kind = follow_up_kind(lambda spec, assets: TaskResult(patterns=[]), lambda spec: None)
    assert follow_up(folder, solved_tasks(folder), runner, kind, folder / "patterns", "patterns").done == 3
    monkeypatch.delenv("SHIFT3D_TEST_FAILS")
    assert sweep.run_with(parse(["sweep", str(tmp_path / "out"), "--retry-quarantined"]), cheap_task.KIND) == 0
    again = solved_tasks(folder)
    (tmp_path / "out" / "patterns").rename(tmp_path / "out" / "verification")
    with pytest.raises(InputError, match=r"out/verification: was begun before further tasks.*Remove this folder"):
        verify_sweep(folder, again, runner)
    assert follow_up(folder, again, runner, kind, folder / "patterns", "patterns").done == 4


def test_ctrl_c_while_quarantined_tasks_run_again_leaves_them_to_the_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No final tables are written, which would report the tasks as failed again."""
    monkeypatch.setenv("SHIFT3D_TEST_FAILS", "coupe")
    words = [*WORDS, "runner.abort_share=null", "runner.abort_after=null", f"out={tmp_path / 'out'}"]
    assert sweep.run_with(parse(words), cheap_task.KIND) == 3
    monkeypatch.delenv("SHIFT3D_TEST_FAILS")

    def run_and_be_interrupted(spec: TaskSpec, assets: dict[str, float]) -> TaskResult:
        os.kill(os.getpid(), signal.SIGINT)
        return cheap_task.run(spec, assets)

    again = ["sweep", str(tmp_path / "out"), "--retry-quarantined"]
    interrupted = dataclasses.replace(cheap_task.KIND, run=run_and_be_interrupted)
    assert sweep.run_with(parse(again), interrupted) == 130
    assert sweep.run_with(parse(again), cheap_task.KIND) == 0
