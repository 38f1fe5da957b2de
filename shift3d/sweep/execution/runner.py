"""Runners of a plan's tasks: in this process, or through Ray."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from shift3d.settings.schema.config import LocalRunnerConfig, RunnerConfig
from shift3d.sweep.execution.backlog import Backlog, BatchSizer
from shift3d.sweep.execution.worker import BatchOutcome, Running, Worker
from shift3d.sweep.planning.kind import TaskKind, reproduce_command
from shift3d.sweep.planning.plan import Plan


class Runner(Protocol):
    """Interface of a runner, which runs tasks and yields outcomes in any order."""

    @property
    def workers(self) -> int:
        """Current target number of workers."""

    @property
    def left_out(self) -> Sequence[str]:
        """Lines on the machines that can run no task, one per machine."""

    def run(self, positions: np.ndarray, stop: threading.Event) -> Iterator[BatchOutcome]:
        """Run until all tasks have an outcome or, once ``stop`` is set, until the tasks in flight have one.

        The runner may yield an outcome without tasks at any time, so that the caller can commit and redraw.

        Args: positions: of the tasks in the plan.
        """

    def running(self) -> list[Running]:
        """Return the calls in flight, oldest first."""

    def close(self) -> None:
        """End all started processes at once."""


class LocalRunner:
    """`Runner` in this process, one task at a time. A hanging task is not ended: no other process watches it."""

    workers = 1
    left_out: Sequence[str] = ()

    def __init__(self, kind: TaskKind, plan: Plan, batch_seconds: float, tried: dict[int, int]) -> None:
        self._plan = plan
        self._tried = tried
        self._worker = Worker(kind, plan.sweep, plan.assets, reproduce_command(kind, plan))
        self._sizer = BatchSizer(batch_seconds)
        self._running: list[Running] = []

    def run(self, positions: np.ndarray, stop: threading.Event) -> Iterator[BatchOutcome]:
        backlog = Backlog(positions, self._tried)
        while len(backlog) and not stop.is_set():
            batch = backlog.take(self._sizer.size(len(backlog), 1))
            tasks = [self._plan.tasks[position] for position in batch]
            self._running = [Running(tasks[0], len(tasks), 0.0, "this process")]
            yield BatchOutcome()
            outcome = self._worker.run_batch(tasks, stop.is_set, backlog.first_attempt(batch))
            self._sizer.finished(len(outcome.done) + len(outcome.quarantined), outcome.seconds)
            yield outcome
            if outcome.fatal:
                return

    def running(self) -> list[Running]:
        return self._running

    def close(self) -> None:
        """Do nothing: there is no process to end."""


def make_runner(kind: TaskKind, plan: Plan, config: RunnerConfig, tasks_left: int, tried: dict[int, int]) -> Runner:
    """Return the runner that the settings name.

    Args: tasks_left: maximum number of workers. tried: attempts of earlier runs by position.
    """
    if isinstance(config, LocalRunnerConfig):
        return LocalRunner(kind, plan, config.commit_seconds, tried)
    from shift3d.sweep.execution.ray.runner import RayRunner

    return RayRunner(kind, plan, config, tasks_left, tried)
