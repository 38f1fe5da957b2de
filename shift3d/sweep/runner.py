"""What runs a plan's tasks: in this process, or through Ray."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from typing import Protocol

from shift3d.config.schema import LocalRunnerConfig, RayRunnerConfig
from shift3d.sweep.batches import BatchSizer
from shift3d.sweep.kind import TaskKind
from shift3d.sweep.plan import Plan, PlannedTask
from shift3d.sweep.worker import BatchOutcome, Worker

__all__ = ["LocalRunner", "Runner", "make_runner"]


class Runner(Protocol):
    """Runs tasks and yields outcomes as they come, in any order."""

    workers: int

    def run(self, tasks: Sequence[PlannedTask], stop: threading.Event) -> Iterator[BatchOutcome]:
        """Run until all tasks have an outcome, or, once ``stop`` is set, until those in flight have one.

        An outcome without tasks may be yielded at any time: a chance for the caller to commit and to draw.
        """
        ...

    def close(self) -> None:
        """End what was started, at once."""
        ...


class LocalRunner:
    """This process, one task after the other."""

    workers = 1

    def __init__(self, kind: TaskKind, plan: Plan, batch_seconds: float) -> None:
        self._worker = Worker(kind, plan.sweep, plan.assets)
        self._sizer = BatchSizer(batch_seconds)

    def run(self, tasks: Sequence[PlannedTask], stop: threading.Event) -> Iterator[BatchOutcome]:
        """See :class:`Runner`."""
        start = 0
        while start < len(tasks) and not stop.is_set():
            size = self._sizer.size(len(tasks) - start, 1)
            outcome = self._worker.run_batch(tasks[start : start + size], stop.is_set)
            ran = len(outcome.done) + len(outcome.quarantined)
            self._sizer.finished(ran, outcome.seconds)
            start += ran
            yield outcome
            if outcome.fatal:
                return

    def close(self) -> None:
        """Nothing to end."""


def make_runner(kind: TaskKind, plan: Plan, config: RayRunnerConfig | LocalRunnerConfig, tasks_left: int) -> Runner:
    """The runner that the settings name. tasks_left: no more workers than this are started."""
    if isinstance(config, LocalRunnerConfig):
        return LocalRunner(kind, plan, config.commit_seconds)
    from shift3d.sweep.runner_ray import RayRunner

    return RayRunner(kind, plan, config, tasks_left)
