"""What runs a plan's tasks: in this process, or through Ray."""

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
    """Runs tasks and yields outcomes as they come, in any order."""

    @property
    def workers(self) -> int:
        """How many there are to be, now."""

    @property
    def left_out(self) -> Sequence[str]:
        """A line of each machine that can run no task."""

    def run(self, positions: np.ndarray, stop: threading.Event) -> Iterator[BatchOutcome]:
        """Run until all tasks have an outcome, or, once ``stop`` is set, until those in flight have one.

        An outcome without tasks may be yielded at any time: a chance for the caller to commit and to draw.

        Args: positions: of the tasks in the plan.
        """

    def running(self) -> list[Running]:
        """What is in flight, the oldest first."""

    def close(self) -> None:
        """End what was started, at once."""


class LocalRunner:
    """A `Runner` in this process, one task after the other. One that hangs is not ended: nobody is here to do it."""

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
        """Nothing to end."""


def make_runner(kind: TaskKind, plan: Plan, config: RunnerConfig, tasks_left: int, tried: dict[int, int]) -> Runner:
    """The runner that the settings name.

    Args: tasks_left: no more workers than this are started. tried: attempts of earlier runs by position.
    """
    if isinstance(config, LocalRunnerConfig):
        return LocalRunner(kind, plan, config.commit_seconds, tried)
    from shift3d.sweep.execution.ray.runner import RayRunner

    return RayRunner(kind, plan, config, tasks_left, tried)
