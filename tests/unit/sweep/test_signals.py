"""Signals to a running sweep at any moment: returned results are committed, and the status states the end."""

from __future__ import annotations

import functools
import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import valid_sweeps

from shift3d.errors import InputError
from shift3d.settings.schema.config import LocalRunnerConfig
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.sweep.drive import SweepResult, run_sweep
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.results.commit import Committer
from shift3d.sweep.status import read_status
from shift3d.task.exchange import TaskResult
from shift3d.task.spec import TaskSpec

FULL = InputError("the disk is full")
LATE = LocalRunnerConfig(kind="local", commit_seconds=1e6, abort_after=None, abort_share=None)
AT_ONCE = LATE.model_copy(update={"commit_seconds": 0.0})


def interrupt(times: int = 1) -> None:
    for _ in range(times):
        os.kill(os.getpid(), signal.SIGINT)


def run(
    folder: Path,
    config: LocalRunnerConfig,
    task: Callable[[], object] = lambda: None,
    prepare: Callable[..., object] | None = None,
) -> SweepResult:
    def execute(*_: object) -> TaskResult:
        task()
        return TaskResult()

    kind = TaskKind(execute, lambda _: None, execute, prepare=prepare)  # type: ignore[arg-type]
    return run_sweep(valid_sweeps.plan(), config, kind, folder, finish=lambda *_: None)  # type: ignore[arg-type, return-value]


def committed(folder: Path) -> int:
    return sum(len(entry.done) for entry in read_log(folder))


def state(folder: Path) -> str:
    progress = read_status(folder).progress
    assert progress is not None
    return str(progress["state"])


def before(method: Callable[..., Any], first: Callable[[], object]) -> Callable[..., Any]:
    """Return the method with another call before it."""

    @functools.wraps(method)
    def called(*arguments: Any) -> Any:
        first()
        return method(*arguments)

    return called


def test_a_second_signal_as_the_last_commit_begins_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Committer, "flush", before(Committer.flush, interrupt))
    assert run(tmp_path, LATE, interrupt).done == committed(tmp_path) == 1
    assert state(tmp_path) == "interrupted"


def test_signals_after_a_commit_that_failed_leave_its_error_and_its_second_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tries: list[int] = []

    def fails_once() -> None:
        tries.append(0)
        if len(tries) == 1:
            raise FULL
        interrupt(2)

    monkeypatch.setattr(CommitLog, "commit", before(CommitLog.commit, fails_once))
    with pytest.raises(InputError, match="the disk is full"):
        run(tmp_path, AT_ONCE)
    assert (len(tries), committed(tmp_path), state(tmp_path)) == (2, 1, "stopped")
    assert "dropping" not in capsys.readouterr().err, "nothing is in flight"


def test_a_sweep_whose_last_commit_fails_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise FULL

    monkeypatch.setattr(CommitLog, "commit", before(CommitLog.commit, fails))
    with pytest.raises(InputError, match="the disk is full"):
        run(tmp_path, LATE)
    assert (committed(tmp_path), state(tmp_path)) == (0, "stopped")


def test_the_second_signal_ends_a_task_that_takes_long(tmp_path: Path) -> None:
    assert run(tmp_path, LATE, lambda: interrupt(2)).done == committed(tmp_path) == 0
    assert state(tmp_path) == "interrupted"


def test_a_signal_while_the_driver_makes_what_workers_share_stops_the_sweep(tmp_path: Path) -> None:
    """The signal arrives while the specs of the remaining tasks are prepared, without their scene."""
    given: list[TaskSpec] = []

    def prepare(_: object, templates: Sequence[TaskSpec]) -> None:
        given.extend(templates)
        interrupt()

    # As in a terminal: a process started in the background ignores the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path, LATE, prepare=prepare)
    finally:
        signal.signal(signal.SIGINT, before)
    assert state(tmp_path) == "stopped"
    assert given == list(valid_sweeps.plan().tasks.templates)
