"""Ray runner: long-lived actors that hold the assets, with one call in flight each.

Failures of a call and their consequences (design section 9):

- the worker died with several tasks: the culprit is unknown, so each task is run again alone, and none is charged;
- the worker died, ran out of memory or hung with one task: the task is charged, and quarantined the second time;
- the machine was lost: its tasks are run again, not charged;
- the machine cannot load the assets: its tasks are run again elsewhere, not charged. If no machine can, the sweep ends;
- tasks of three scenes in a row cannot read or write files there: the next ones run on another machine, if any.

Source: our choice.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from shift3d.errors import InputError
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.backlog import Backlog, BatchSizer
from shift3d.sweep.execution.ray.calls import Call, Calls
from shift3d.sweep.execution.ray.connection import connect, ended_process
from shift3d.sweep.execution.ray.excluded_machines import MAX_UNREADABLE_SCENES
from shift3d.sweep.execution.ray.failures import Failure, failure_of
from shift3d.sweep.execution.ray.hang_detector import HangDetector
from shift3d.sweep.execution.ray.shipped_files import read_shipped_files
from shift3d.sweep.execution.ray.worker import RayWorker
from shift3d.sweep.execution.ray.worker_pool import WorkerPool
from shift3d.sweep.execution.worker import BatchOutcome, Running, attempt_row
from shift3d.sweep.planning.kind import TaskKind, reproduce_command, with_command
from shift3d.sweep.planning.plan import Plan
from shift3d.wording import counted

_HEARTBEAT_S = 0.5


class RayRunner:
    """`Runner` with tasks in Ray actors, on this machine or a cluster.

    tasks_left: maximum number of workers. tried: attempts of earlier runs by position.
    Raises: InputError: the cluster cannot be reached, or has no room for a worker; a file to ship cannot be read.
    """

    def __init__(
        self, kind: TaskKind, plan: Plan, config: RayRunnerConfig, tasks_left: int, tried: dict[int, int] | None = None
    ) -> None:
        self._plan = plan
        self._tried = tried
        self._command = reproduce_command(kind, plan)
        self._ray = connect(config, tasks_left)
        try:
            memory_mb = config.worker_memory_mb or kind.memory_mb
            self._pool = WorkerPool(self._ray, self._starter(kind, config), config, memory_mb, tasks_left)
        except InputError:
            self.close()
            raise
        self._sizer = BatchSizer(config.batch_seconds)
        self._calls = Calls(least_s=2 * config.batch_seconds)
        self._watch = HangDetector(self._ray, config.task_timeout_s)
        self._backlog = Backlog([])

    def _starter(self, kind: TaskKind, config: RayRunnerConfig) -> Callable[..., Any]:
        # The driver handles crashes, so Ray itself retries nothing.
        options: dict[str, Any] = {"num_cpus": config.cpus_per_worker, "max_restarts": 0, "max_task_retries": 0}
        if config.worker_memory_mb:
            options["memory"] = int(config.worker_memory_mb * 2**20)
        actor = self._ray.remote(**options)(RayWorker)
        # Workers of a private Ray are on this machine, and read its files.
        shipped = self._ray.put(read_shipped_files(self._plan.assets) if config.address else {})
        tasks, assets = self._ray.put(self._plan.tasks), self._ray.put(self._plan.assets)
        given = (kind, self._plan.sweep, assets, tasks, self._command, shipped)
        return lambda **options: (actor.options(**options) if options else actor).remote(*given)

    @property
    def workers(self) -> int:
        """Target number of workers; it changes as machines join and leave."""
        return self._pool.wanted

    @property
    def left_out(self) -> list[str]:
        return self._pool.left_out.lines

    def running(self) -> list[Running]:
        tasks = self._plan.tasks
        return [
            Running(tasks[c.positions[0]], len(c.positions), c.seconds, c.worker.process) for c in self._calls.live()
        ]

    def run(self, positions: np.ndarray, stop: threading.Event) -> Iterator[BatchOutcome]:
        self._backlog = Backlog(positions, self._tried)
        while self._calls or (self._backlog and not stop.is_set()):
            if error := ended_process():
                yield BatchOutcome(fatal=error)
                return
            self._pool.grow(len(self._backlog) + len(self._calls))
            self._give_out(stop)
            waited = [*self._calls.references, *self._pool.starting]
            ready, _ = self._ray.wait(waited, num_returns=1, timeout=_HEARTBEAT_S) if waited else ([], [])
            outcome = self._end_of(ready[0]) if ready else BatchOutcome()
            yield outcome
            if outcome.fatal:
                return
            for hang in self._watch.hanging(self._calls.every()):
                _, wanted = self._calls.pop(hang.call.reference)
                self._pool.lost(hang.call.worker)
                if wanted:
                    yield self._failed_call(hang.call, hang.failure, hang.position)

    def _give_out(self, stop: threading.Event) -> None:
        while not stop.is_set() and (worker := self._pool.idle()):
            if len(self._backlog):
                size = self._sizer.size(len(self._backlog), self._pool.wanted)
                positions, late = self._backlog.take(size, worker.process), None
                attempt = self._backlog.first_attempt(positions)
            elif late := self._calls.straggler():
                positions, attempt = late.positions, late.attempt + 1
                self._backlog.tried(positions, attempt)
            else:
                return
            call = Call(worker.actor.run.remote(positions, attempt), worker, positions, attempt, copy=late)
            if late:
                late.copy = call
            self._calls.add(call)

    def _end_of(self, reference: Any) -> BatchOutcome:
        if reference in self._pool.starting:
            return BatchOutcome(fatal=self._pool.started(reference))
        call, wanted = self._calls.pop(reference)
        try:
            outcome: BatchOutcome = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            self._pool.lost(call.worker)
            if not wanted:
                return BatchOutcome()
            return self._failed_call(call, failure_of(self._ray, error, call.worker.node_id))
        if outcome.fatal:
            return self._not_loaded(call, outcome, outcome.fatal, wanted)
        self._leave_unreadable(call, outcome)
        self._pool.left_out.show()
        if not wanted:
            return BatchOutcome()
        ran = len(outcome.done) + len(outcome.quarantined)
        self._calls.finished(call, ran, outcome.seconds)
        self._sizer.finished(ran, outcome.seconds)
        return outcome

    def _leave_unreadable(self, call: Call, outcome: BatchOutcome) -> None:
        """Leave a machine out if tasks of several scenes in a row could not read or write a file: another may."""
        worker, left_out = call.worker, self._pool.left_out
        scenes = {self._plan.tasks[at].spec.scene for at in call.positions if self._id(at) in outcome.unread}
        too_many = left_out.unread(worker.node_id, scenes, bool(outcome.done))
        if worker.node_id in left_out:
            self._pool.lost(worker)
        elif too_many and left_out.any_other(worker.node_id):
            what = f"tasks of {counted(MAX_UNREADABLE_SCENES, 'scene')} in a row failed there: {outcome.errors[-1]}"
            remedy = "Repair it, and give those tasks back with --retry-quarantined"
            self._pool.leave(worker.node_id, worker.host, InputError(what, remedy=remedy))

    def _not_loaded(self, call: Call, outcome: BatchOutcome, error: InputError, wanted: bool) -> BatchOutcome:
        """Handle a machine that cannot load the assets: others run its tasks. Without others, return `outcome`."""
        line = self._pool.left_out.add(call.worker.node_id, call.worker.host, error)
        self._pool.lost(call.worker)
        if not wanted:
            return BatchOutcome()
        return self._failed_call(call, Failure("not_loaded", line)) if self._pool.left_out.any_other() else outcome

    def _failed_call(self, call: Call, failure: Failure, culprit: int | None = None) -> BatchOutcome:
        """Handle a call that ended without a result. culprit: the task that caused it, if known."""
        if culprit is None and len(call.positions) == 1 and failure.kind != "not_loaded":
            culprit = call.positions[0]
        self._backlog.tried(call.positions, call.attempt)
        # If the culprit is known, or no task caused the failure, the others may stay together.
        apart = culprit is None and failure.kind not in ("node_lost", "not_loaded")
        copied = self._calls.copy_of(call) is not None
        quarantined = self._backlog.failed(call.positions, culprit, failure.charged, apart, copied)
        rows = [
            self._row(position, call, failure, position == culprit, quarantined and position == culprit)
            for position in call.positions
        ]
        outcome = BatchOutcome(tables={"attempts": table_from_rows("attempts", rows)})
        if culprit is not None and quarantined:
            outcome.quarantined = [self._id(culprit)]
            outcome.errors = [f"{failure.kind}: {failure.what}"]
        return outcome

    def _id(self, position: int) -> str:
        return str(self._plan.tasks.ids[position])

    def _row(self, position: int, call: Call, failure: Failure, alone: bool, quarantined: bool) -> dict[str, Any]:
        outcome = failure.kind if alone or not failure.charged else "bystander"
        row = attempt_row(self._id(position), call.attempt, outcome, call.began_unix_s, call.seconds)
        row |= {"error": failure.what, "traceback": failure.traceback if alone else None, "quarantined": quarantined}
        row |= {"worker": call.worker.process}
        return with_command(row, self._command) if quarantined else row

    def close(self) -> None:
        """End the workers, and the private Ray if there is one."""
        self._ray.shutdown()
