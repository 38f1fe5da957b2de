"""A worker as Ray runs it: given positions of a plan that it holds, and asked beside its work what it is at."""

from __future__ import annotations

import dataclasses
import os
import socket
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass

from shift3d.sweep.freight import Freight, unloaded
from shift3d.sweep.kind import TaskKind
from shift3d.sweep.tasks import PlannedTask
from shift3d.sweep.worker import BatchOutcome, Worker
from shift3d.task.spec import AssetsSpec

__all__ = ["BESIDE", "Greeting", "RayWorker", "Whereabouts"]

BESIDE = "beside"
"""Ray's name for the thread that answers while a task runs."""


@dataclass(frozen=True)
class Greeting:
    """Where a worker runs. node_id: Ray's. process: host and process id."""

    node_id: str
    process: str


@dataclass(frozen=True)
class Whereabouts:
    """What a worker is at: the task's place in its call (None between tasks), for how long, and its stack."""

    index: int | None
    seconds: float
    stack: str


class RayWorker:
    """Arguments as of `Worker`; tasks: of the whole plan; freight: files that this machine may not have.

    Tasks, assets and freight come from Ray's object store, where a machine has them once.
    """

    def __init__(
        self,
        kind: TaskKind,
        sweep: str,
        assets: Sequence[AssetsSpec],
        tasks: Sequence[PlannedTask],
        command: str,
        freight: Freight,
    ) -> None:
        self._tasks = tasks
        # With the first task, whose outcome can say in one line why nothing could be loaded.
        load = kind.load
        kind = dataclasses.replace(kind, load=lambda spec: load(unloaded(spec, freight)))
        self._worker = Worker(kind, sweep, assets, command)
        self._thread: int | None = None

    def greet(self) -> Greeting:
        """Answered as soon as this process is ready."""
        import ray

        return Greeting(ray.get_runtime_context().get_node_id(), f"{socket.gethostname()}:{os.getpid()}")

    def run(self, positions: Sequence[int], first_attempt: int) -> BatchOutcome:
        """See `Worker.run_batch`."""
        self._thread = threading.get_ident()
        tasks = [self._tasks[position] for position in positions]
        return self._worker.run_batch(tasks, first_attempt=first_attempt)

    def whereabouts(self) -> Whereabouts:
        """Answered while a call runs, by another thread: unless that one holds the interpreter."""
        index, since = self._worker.current
        frame = sys._current_frames().get(self._thread or 0)
        stack = "".join(traceback.format_stack(frame)[-30:]) if frame else ""
        return Whereabouts(index, time.monotonic() - since, stack)
