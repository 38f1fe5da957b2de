"""Calls in flight: which tasks they hold, how long they have been out, and which of them have a speculative copy."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from shift3d.sweep.execution.ray.worker_pool import PooledWorker

# A call that takes this many times the usual time gets a speculative copy, once a worker is idle.
_STRAGGLES = 3.0


@dataclass(eq=False)
class Call:
    """Tasks that a worker runs. attempt: the number of this try. copy: a speculative copy, on another worker."""

    reference: Any
    worker: PooledWorker
    positions: list[int]
    attempt: int
    began: float = field(default_factory=time.monotonic)
    began_unix_s: float = field(default_factory=time.time)
    copy: Call | None = None
    # Asked where it is: the answer to come and since when, and when to ask again.
    question: Any = None
    questioned_at: float = 0.0
    ask_at: float = float("inf")

    @property
    def seconds(self) -> float:
        """Since it was given out."""
        return time.monotonic() - self.began


class Calls:
    """The calls in flight by the reference that is ready when they end."""

    def __init__(self, least_s: float) -> None:
        self._by_reference: dict[Any, Call] = {}
        self._superseded: set[Any] = set()
        self._least_s = least_s
        self._per_task_s: list[float] = []

    def __len__(self) -> int:
        return len(self._by_reference) - len(self._superseded)

    def live(self) -> list[Call]:
        """Calls whose result is waited for, the oldest first."""
        return [call for call in self._by_reference.values() if call.reference not in self._superseded]

    def every(self) -> list[Call]:
        """All of them, those that another one has superseded included, the oldest first."""
        return list(self._by_reference.values())

    @property
    def references(self) -> list[Any]:
        """Of every call, those that another one has superseded included."""
        return list(self._by_reference)

    def add(self, call: Call) -> None:
        """A call was given out."""
        call.worker.running = True
        self._by_reference[call.reference] = call

    def pop(self, reference: Any) -> tuple[Call, bool]:
        """A call that ended, and whether its result is wanted: of two copies the first to end."""
        call = self._by_reference.pop(reference)
        call.worker.running = False
        wanted = reference not in self._superseded
        self._superseded.discard(reference)
        return call, wanted

    def finished(self, call: Call, tasks: int, seconds: float) -> None:
        """A call gave its result: its copy's is not wanted any more. tasks, seconds: what it ran, for `straggler`."""
        if call.copy is not None and call.copy.reference in self._by_reference:
            self._superseded.add(call.copy.reference)
        if tasks:
            self._per_task_s = [*self._per_task_s[-99:], seconds / tasks]

    def copy_of(self, call: Call) -> Call | None:
        """The copy that is still in flight."""
        return call.copy if call.copy is not None and call.copy.reference in self._by_reference else None

    def straggler(self) -> Call | None:
        """The call that is out longest beyond what is usual and has no copy yet."""
        if not self._per_task_s:
            return None
        usual = sorted(self._per_task_s)[len(self._per_task_s) // 2]
        for call in self.live():
            if call.copy is None and call.seconds > max(_STRAGGLES * usual * len(call.positions), self._least_s):
                return call
        return None
