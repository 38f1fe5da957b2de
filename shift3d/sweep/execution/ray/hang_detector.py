"""Detection of hanging tasks: the driver reads the status file of a worker past the time limit, and ends the worker."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from shift3d.sweep.execution.ray.calls import Call
from shift3d.sweep.execution.ray.failures import Failure
from shift3d.sweep.execution.ray.worker_pool import PooledWorker
from shift3d.sweep.execution.ray.worker_status import WorkerStatus, read_worker_status

# A machine on which a status file cannot be read within this time is overloaded or lost.
_ANSWER_S = 20.0
_LOOK_S = 0.5


@dataclass(frozen=True)
class Hang:
    """Call whose worker must be ended. position: of the hanging task; None if unknown."""

    call: Call
    position: int | None
    failure: Failure


class HangDetector:
    """Detector of hanging calls. timeout_s: limit for one task, None for no limit."""

    def __init__(self, ray: Any, timeout_s: float | None) -> None:
        self._ray = ray
        self._timeout_s = timeout_s
        self._looked = 0.0

    def hanging(self, calls: Iterable[Call]) -> list[Hang]:
        """Return the calls that hang. The function never waits: an answer is read at a later call."""
        if self._timeout_s is None or time.monotonic() - self._looked < _LOOK_S:
            return []
        self._looked = time.monotonic()
        found = (self._look(call, self._timeout_s) for call in calls if call.seconds > self._timeout_s)
        return [hang for hang in found if hang]

    def _look(self, call: Call, timeout_s: float) -> Hang | None:
        now = time.monotonic()
        if call.question is None:
            if call.ask_at == float("inf") or now >= call.ask_at:
                call.question, call.questioned_at = self._ask(call.worker), now
            return None
        ready, _ = self._ray.wait([call.question], timeout=0)
        if ready:
            return self._answered(call, timeout_s)
        return None if now - call.questioned_at < _ANSWER_S else _unseen(call)

    def _ask(self, worker: PooledWorker) -> Any:
        """Start a process on the worker's machine that reads its status. Returns the reference of the answer."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        assert worker.where is not None  # a worker with a call is ready
        there = NodeAffinitySchedulingStrategy(worker.node_id, soft=False)
        read = self._ray.remote(num_cpus=0, max_retries=0, scheduling_strategy=there)(read_worker_status)
        return read.remote(worker.where.status_path, worker.where.pid)

    def _answered(self, call: Call, timeout_s: float) -> Hang | None:
        try:
            at: WorkerStatus = self._ray.get(call.question)
        except self._ray.exceptions.RayError as error:
            if isinstance(error, OSError) and not isinstance(error, ProcessLookupError | FileNotFoundError):
                return _unseen(call)
            call.ask_at = float("inf")  # the worker is dead: its call will report it
            call.question = None
            return None
        call.question = None
        if at.index is None or at.seconds < timeout_s:
            call.ask_at = time.monotonic() + (timeout_s if at.index is None else timeout_s - at.seconds)
            return None
        what = f"no result after {at.seconds:.0f} s (runner.task_timeout_s={timeout_s:g})"
        return Hang(call, call.positions[at.index], Failure("timeout", what, at.stack))


def _unseen(call: Call) -> Hang:
    what = f"no result after {call.seconds:.0f} s, and nobody could see where the worker is"
    return Hang(call, call.positions[0] if len(call.positions) == 1 else None, Failure("timeout", what))
