"""Errors of the file system or network are tried four times with pauses; a missing file twice without."""

from __future__ import annotations

import dataclasses
import errno
import time
from pathlib import Path
from typing import Any

import pytest

from shift3d.errors import InputError
from shift3d.scenes.file_checks import read_bytes
from shift3d.store.location import LocalLocation
from shift3d.sweep.execution.worker import Worker
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan
from shift3d.task.exchange import TaskResult
from shift3d.task.spec import TaskSpec


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    found: list[float] = []
    monkeypatch.setattr(time, "sleep", found.append)
    return found


def outcomes(plan: Plan, failures: list[Exception], reader: Any) -> list[str]:
    """Return the outcome of each try of one task whose file fails with these errors and then is read."""

    def run(spec: object, assets: object) -> TaskResult:
        with pytest.MonkeyPatch.context() as patch:
            if failures:
                patch.setattr(LocalLocation, "read_bytes", lambda self: raise_(failures.pop(0)))
            reader()
        return TaskResult()

    kind = TaskKind(run=run, load=lambda _: None, catalogue=lambda _: None)  # type: ignore[arg-type, return-value]
    assets = [dataclasses.replace(one, threads=1) for one in plan.assets]
    outcome = Worker(kind, plan.sweep, assets).run_batch([plan.tasks[0]])
    rows: list[str] = outcome.tables["attempts"]["outcome"].to_pylist()
    return rows


def raise_(error: Exception) -> bytes:
    raise error


@pytest.mark.parametrize("through_a_reader", [False, True])
def test_an_error_that_passes_is_waited_for(
    through_a_reader: bool, suv_plan: Plan, pauses: list[float], tmp_path: Path
) -> None:
    (tmp_path / "frame").write_bytes(b"points")
    frame = LocalLocation(tmp_path / "frame")
    reader = (lambda: read_bytes(frame, "frame")) if through_a_reader else (lambda: frame.read_bytes())
    again: list[Exception] = [OSError(errno.EIO, "Input/output error") for _ in range(3)]
    assert outcomes(suv_plan, again, reader) == ["failed", "failed", "failed", "done"]
    assert pauses == [0.5, 2.0, 8.0]


@pytest.mark.parametrize("error", [FileNotFoundError(), PermissionError(), InputError("no points")])
def test_what_is_missing_or_damaged_is_not_waited_for(
    error: Exception, suv_plan: Plan, pauses: list[float], tmp_path: Path
) -> None:
    reader = lambda: read_bytes(LocalLocation(tmp_path / "frame"), "frame")  # noqa: E731
    assert outcomes(suv_plan, [error, error], reader) == ["failed", "failed"]
    assert pauses == []


def test_of_tasks_that_fail_those_that_files_failed_are_told_from_others(suv_plan: Plan, pauses: list[float]) -> None:
    errors = {suv_plan.tasks[0].spec.task_id: OSError(errno.EIO, "Input/output error")}

    def run(spec: TaskSpec, assets: object) -> TaskResult:
        raise errors.get(spec.task_id, ArithmeticError("no root"))

    kind = TaskKind(run=run, load=lambda _: None, catalogue=lambda _: None)  # type: ignore[arg-type, return-value]
    assets = [dataclasses.replace(one, threads=1) for one in suv_plan.assets]
    outcome = Worker(kind, suv_plan.sweep, assets).run_batch([suv_plan.tasks[0], suv_plan.tasks[1]])
    assert len(outcome.quarantined) == 2 and outcome.unread == list(errors)
