"""Calls in flight to Ray workers: their tasks, their durations, and their speculative copies."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from shift3d.sweep.execution.ray.worker_pool import PooledWorker

# A call that takes this many times the usual time gets a speculative copy on an idle worker.
_STRAGGLES = 3.0


@dataclass(eq=False)
class Call:
    """Tasks that a worker runs. attempt: number of this try. copy: other call of the same tasks, on another worker."""

    reference: Any
    worker: PooledWorker
    positions: list[int]
    attempt: int
    began: float = field(default_factory=time.monotonic)
    began_unix_s: float = field(default_factory=time.time)
    copy: Call | None = None
    # Query of the worker's status: pending answer, time of the query, and time for the next query.
    question: Any = None
    questioned_at: float = 0.0
    ask_at: float = float("inf")

    @property
    def seconds(self) -> float:
        """Time since the call was given out."""
        return time.monotonic() - self.began


class Calls:
    """Calls in flight, by the reference that is ready when a call ends. least_s: minimum duration of a straggler."""

    def __init__(self, least_s: float) -> None:
        self._by_reference: dict[Any, Call] = {}
        self._superseded: set[Any] = set()
        self._least_s = least_s
        self._per_task_s: list[float] = []

    def __len__(self) -> int:
        return len(self._by_reference) - len(self._superseded)

    def live(self) -> list[Call]:
        """Return the calls whose result is wanted, oldest first."""
        return [call for call in self._by_reference.values() if call.reference not in self._superseded]

    def every(self) -> list[Call]:
        """Return all calls, superseded ones included, oldest first."""
        return list(self._by_reference.values())

    @property
    def references(self) -> list[Any]:
        """References of all calls, superseded ones included."""
        return list(self._by_reference)

    def add(self, call: Call) -> None:
        """Register a call that was given out."""
        call.worker.running = True
        self._by_reference[call.reference] = call

    def pop(self, reference: Any) -> tuple[Call, bool]:
        """Remove an ended call. Return the call, and True if its result is wanted: of two copies, the first to end."""
        call = self._by_reference.pop(reference)
        call.worker.running = False
        wanted = reference not in self._superseded
        self._superseded.discard(reference)
        return call, wanted

    def finished(self, call: Call, tasks: int, seconds: float) -> None:
        """Record a call with a result, and mark its copy superseded. tasks, seconds: of the call, for `straggler`."""
        if call.copy is not None and call.copy.reference in self._by_reference:
            self._superseded.add(call.copy.reference)
        if tasks:
            self._per_task_s = [*self._per_task_s[-99:], seconds / tasks]

    def copy_of(self, call: Call) -> Call | None:
        """Return the copy of a call if it is still in flight, else None."""
        return call.copy if call.copy is not None and call.copy.reference in self._by_reference else None

    def straggler(self) -> Call | None:
        """Return the oldest call that far exceeds the usual time and has no copy, or None."""
        if not self._per_task_s:
            return None
        usual = sorted(self._per_task_s)[len(self._per_task_s) // 2]
        for call in self.live():
            if call.copy is None and call.seconds > max(_STRAGGLES * usual * len(call.positions), self._least_s):
                return call
        return None
