"""Worker that runs tasks in batches, in any process; each task is tried, retried or quarantined."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.processor import configure_runtime
from shift3d.store.schemas import SCHEMAS, SEGMENTS, SPEC_COLUMNS
from shift3d.store.tables import table_from_rows
from shift3d.sweep.planning.kind import TaskKind, with_command
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.task.exchange import AssetsSpec, Row, TaskResult
from shift3d.task.spec import TaskSpec

# Tries per task, and the pauses before further tries of I/O. A deterministic failure gets a second try in case it was
# not deterministic; a failure of the file system or the network may pass.
_DETERMINISTIC_TRIES = 2
_IO_TRIES = 4
_IO_PAUSE_S = (0.5, 2.0, 8.0)
# Errors of the file system that do not pass: readers report missing files with them.
_LASTING = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError)
_RELEASE_MEMORY_AFTER_S = 1.0
"""Batch duration from which memory is given back, which takes some hundredths of a second."""


@dataclass(frozen=True)
class Running:
    """Call in flight. task: its first task. tasks: number of tasks. seconds: time since it was given out.

    worker: host and process that run it.
    """

    task: PlannedTask
    tasks: int
    seconds: float
    worker: str

    @property
    def label(self) -> str:
        """Text with vehicle/scene, mode, and the number of further tasks."""
        spec = self.task.spec
        more = f" +{self.tasks - 1}" if self.tasks > 1 else ""
        return f"{spec.vehicle}/{spec.scene} {spec.mode}{more}"


@dataclass
class BatchOutcome:
    """Results of one batch.

    done, quarantined: task ids in the order they were run. tables: segment tables by name. errors: one per quarantined
    task. unread: quarantined tasks whose files could not be read or written. fatal: reason why no task can run at all
    (assets cannot be loaded); it stops the sweep. peak_mb: peak memory of the worker's process, 10^6 bytes.
    """

    done: list[str] = field(default_factory=list)
    quarantined: list[str] = field(default_factory=list)
    tables: dict[str, pa.Table] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    fatal: InputError | None = None
    seconds: float = 0.0
    peak_mb: float = 0.0


def attempt_row(task_id: str, attempt: int, outcome: str, started_unix_s: float, seconds: float) -> Row:
    """Return one row of ``attempts``, with this process as the worker.

    outcome: done; failed or out_of_memory (exception of the task); crashed, out_of_memory or timeout (end of its
    worker); bystander (end of a worker that also had other tasks); node_lost or unreachable (failure of its machine);
    not_loaded (its machine cannot load the assets). seconds: by a monotonic clock.
    """
    return {
        "task_id": task_id,
        "attempt": attempt,
        "outcome": outcome,
        "error": None,
        "traceback": None,
        "quarantined": False,
        "worker": _process(),
        "started_unix_s": started_unix_s,
        "seconds": seconds,
    }


@functools.cache
def _process() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


class Worker:
    """Worker that holds the assets and runs tasks, in this process or in a Ray actor.

    command: command that reproduces a task, up to its id. note: called with the index in its batch of each task that
    begins, and with None after the last one.
    """

    def __init__(
        self,
        kind: TaskKind,
        sweep: str,
        assets: Sequence[AssetsSpec],
        command: str = "",
        note: Callable[[int | None], None] = lambda _: None,
    ) -> None:
        self._kind = kind
        self._sweep = sweep
        self._assets_specs = assets
        self._command = command
        self._assets: dict[int, Any] = {}
        self._note = note

    def run_batch(
        self, tasks: Sequence[PlannedTask], stop: Callable[[], bool] = lambda: False, first_attempt: int = 1
    ) -> BatchOutcome:
        """Run tasks in order.

        Args:
            stop: called before each task; after True, the remaining tasks are in neither list of the outcome.
            first_attempt: number of the first try, for ``attempts``.
        """
        began = time.perf_counter()
        outcome = BatchOutcome()
        results: list[_Rows] = []
        for index, task in enumerate(tasks):
            if stop():
                break
            try:
                assets = self._load(task.assets)
            except InputError as error:
                outcome.fatal = error
                break
            self._note(index)
            results.append(self._run_task(task.spec, assets, first_attempt))
        self._note(None)
        outcome.tables = self._tables_of(results)
        for rows in results:
            (outcome.done if rows.done else outcome.quarantined).append(rows.task_id)
            if not rows.done:
                outcome.errors.append(rows.attempts[-1]["error"])
            if rows.unread:
                outcome.unread.append(rows.task_id)
        outcome.seconds = time.perf_counter() - began
        outcome.peak_mb = _peak_mb()
        if outcome.seconds > _RELEASE_MEMORY_AFTER_S:
            _release_free_memory()
        return outcome

    def _tables_of(self, results: list[_Rows]) -> dict[str, pa.Table]:
        try:
            return _tables(results)
        except ValueError:
            for rows in results:
                _refuse_broken_rows(rows, self._command)
            return _tables(results)

    def _load(self, index: int) -> Any:
        if index not in self._assets:
            threads = self._assets_specs[index].threads
            configure_runtime(threads)
            self._assets[index] = self._kind.load(self._assets_specs[index])
            configure_runtime(threads)  # again, since loading may have imported torch
        return self._assets[index]

    def _run_task(self, spec: TaskSpec, assets: Any, attempt: int) -> _Rows:
        rows = _Rows(spec.task_id)
        tries = 0
        while True:
            started, began = time.time(), time.perf_counter()
            tries += 1
            try:
                result = completed_rows(spec, self._sweep, self._kind.run(spec, assets))
            except Exception as error:
                io = _is_io(error)
                quarantined = tries >= (_IO_TRIES if io else _DETERMINISTIC_TRIES)
                outcome = "out_of_memory" if isinstance(error, MemoryError) else "failed"
                row = attempt_row(spec.task_id, attempt, outcome, started, time.perf_counter() - began)
                row |= _failure(error, quarantined)
                rows.attempts.append(with_command(row, self._command) if quarantined else row)
                if quarantined:
                    rows.unread = io
                    return rows
                if io:
                    time.sleep(_IO_PAUSE_S[tries - 1])
                attempt += 1
                continue
            rows.done, rows.result = True, result
            rows.attempts.append(attempt_row(spec.task_id, attempt, "done", started, time.perf_counter() - began))
            return rows


def _is_io(error: BaseException) -> bool:
    """True if the file system or the network failed: an OSError, or an InputError that a passing OSError caused."""
    if not isinstance(error, InputError):
        return isinstance(error, OSError)
    cause = error.__cause__
    while cause is not None and not isinstance(cause, OSError):
        cause = cause.__cause__
    return cause is not None and not isinstance(cause, _LASTING)


def _release_free_memory() -> None:
    """Return the memory of freed tensors from glibc's allocator to the system.

    The tensors of a task have many sizes, which fragment the heap: a Ray worker held 3 GB after a dozen shape attacks.
    In a separate process with 2.0 GB after two short attacks, this call left 1.3 GB.
    """
    import ctypes

    with contextlib.suppress(OSError, AttributeError, TypeError):  # no glibc, or no library to load
        ctypes.CDLL(None).malloc_trim(0)


def _peak_mb() -> float:
    """Return the peak resident memory of this process, 10^6 bytes."""
    # /proc is preferred to getrusage, whose maximum survives exec: a child would start with the peak of its parent.
    status = Path("/proc/self/status")
    if status.is_file():
        found = [line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM:")]
        if found:
            return int(found[0]) * 1024 / 1e6
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def completed_rows(spec: TaskSpec, sweep: str, result: TaskResult) -> dict[str, list[Row]]:
    """Return the rows of a result, with the columns that the spec determines filled in."""
    known: Row = {name: getattr(spec, name) for name in SPEC_COLUMNS if name not in ("sweep", "lambda")}
    known |= {"sweep": sweep, "lambda": spec.lambda_}
    found = {}
    for name, rows in vars(result).items():
        names = SCHEMAS[name].names if rows else ()  # Arrow builds a list at every access
        own = {column: known[column] for column in names if column in known}
        effects = {"effects": list(spec.effects)} if "effects" in names else {}
        found[name] = [effects | row | own for row in rows]
    return found


@dataclass
class _Rows:
    task_id: str
    done: bool = False
    unread: bool = False
    result: dict[str, list[Row]] = field(default_factory=dict)
    attempts: list[Row] = field(default_factory=list)


def _tables(results: Sequence[_Rows]) -> dict[str, pa.Table]:
    found = [{**rows.result, "attempts": rows.attempts} for rows in results]
    return {name: table_from_rows(name, [row for rows in found for row in rows.get(name, ())]) for name in SEGMENTS}


def _refuse_broken_rows(rows: _Rows, command: str) -> None:
    """Quarantine a task whose rows do not fit their schema. Other tasks of the batch are not affected."""
    try:
        _tables([rows])
    except ValueError as error:
        failed = {**rows.attempts[-1], "outcome": "failed", **_failure(error, True)}
        rows.attempts[-1] = with_command(failed, command)
        rows.done, rows.result = False, {}


def _failure(error: Exception, quarantined: bool) -> Row:
    text = "".join(traceback.format_exception(error))[-20_000:]
    return {"error": f"{type(error).__name__}: {error}"[:2_000], "traceback": text, "quarantined": quarantined}
