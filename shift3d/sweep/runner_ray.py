"""Ray workers: long-lived actors that hold the weights, one call in flight each."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from shift3d.config.schema import RayRunnerConfig
from shift3d.errors import InputError
from shift3d.store.tables import table_from_rows
from shift3d.sweep.batches import BatchSizer
from shift3d.sweep.kind import TaskKind
from shift3d.sweep.plan import Plan, PlannedTask
from shift3d.sweep.ray_connection import connect
from shift3d.sweep.worker import BatchOutcome, Worker, attempt_row

__all__ = ["RayRunner"]

# A task that was alone in a worker each time it crashed is given up on after so many crashes.
_CRASHES = 2
_HEARTBEAT_S = 0.5


@dataclass
class _Call:
    actor: Any
    tasks: list[PlannedTask]
    started: float


class RayRunner:
    """Runs tasks in Ray actors, on this machine or a cluster.

    Raises:
        InputError: the cluster cannot be reached, or has no room for a worker.
    """

    def __init__(self, kind: TaskKind, plan: Plan, config: RayRunnerConfig, tasks_left: int) -> None:
        self._ray = connect(config, tasks_left)
        room = int(self._ray.cluster_resources().get("CPU", 0) // config.cpus_per_worker)
        if room < 1:
            self.close()
            raise InputError(
                f"Ray has no room for a worker of {config.cpus_per_worker} CPUs",
                where="runner",
                remedy="Lower runner.cpus_per_worker, or use runner=local",
            )
        self.workers = max(1, min(config.workers or room, tasks_left))
        # One call in flight each, and a crash is the driver's to handle: Ray itself retries nothing.
        actor = self._ray.remote(num_cpus=config.cpus_per_worker, max_restarts=0, max_task_retries=0)(Worker)
        self._start: Callable[[], Any] = lambda: actor.remote(kind, plan.sweep, plan.assets)
        self._sizer = BatchSizer(config.batch_seconds)
        self._crashes: dict[str, int] = {}

    def run(self, tasks: Sequence[PlannedTask], stop: threading.Event) -> Iterator[BatchOutcome]:
        """See :class:`Runner`."""
        queue = deque(tasks)
        alone: deque[PlannedTask] = deque()  # was in a worker that crashed: not together with others again
        idle = [self._start() for _ in range(self.workers)]
        calls: dict[Any, _Call] = {}
        while calls or ((queue or alone) and not stop.is_set()):
            while idle and (queue or alone) and not stop.is_set():
                batch = self._next_batch(queue, alone)
                actor = idle.pop()
                first = 1 + self._crashes.get(batch[0].spec.task_id, 0)
                calls[actor.run_batch.remote(batch, first_attempt=first)] = _Call(actor, batch, time.time())
            ready, _ = self._ray.wait(list(calls), num_returns=1, timeout=_HEARTBEAT_S)
            if not ready:
                yield BatchOutcome()
            for reference in ready:
                call = calls.pop(reference)
                outcome = self._result(reference, call, alone)
                idle.append(call.actor)
                yield outcome
                if outcome.fatal:
                    return

    def _next_batch(self, queue: deque[PlannedTask], alone: deque[PlannedTask]) -> list[PlannedTask]:
        if alone:
            return [alone.popleft()]
        size = self._sizer.size(len(queue), self.workers)
        return [queue.popleft() for _ in range(size)]

    def _result(self, reference: Any, call: _Call, alone: deque[PlannedTask]) -> BatchOutcome:
        errors = self._ray.exceptions
        try:
            outcome: BatchOutcome = self._ray.get(reference)
        except (errors.RayActorError, errors.OutOfMemoryError) as error:
            call.actor = self._start()
            return self._crashed(call, error, alone)
        self._sizer.finished(len(outcome.done) + len(outcome.quarantined), outcome.seconds)
        return outcome

    def _crashed(self, call: _Call, error: Exception, alone: deque[PlannedTask]) -> BatchOutcome:
        """A worker died. Of several tasks nobody knows which did it: each is run again alone."""
        if len(call.tasks) > 1:
            alone.extend(call.tasks)
            return BatchOutcome()
        task = call.tasks[0]
        task_id = task.spec.task_id
        crashes = self._crashes[task_id] = self._crashes.get(task_id, 0) + 1
        given_up = crashes >= _CRASHES
        what = f"the worker died: {' '.join(str(error).split())}"[:2_000]
        row = attempt_row(task_id, crashes, "crashed", call.started, error=what, quarantined=given_up, worker="ray")
        outcome = BatchOutcome(tables={"attempts": table_from_rows("attempts", [row])})
        if given_up:
            outcome.quarantined.append(task_id)
        else:
            alone.append(task)
        return outcome

    def close(self) -> None:
        """End the workers, and the private Ray where there is one."""
        self._ray.shutdown()
