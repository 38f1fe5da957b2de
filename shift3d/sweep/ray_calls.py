"""Calls in flight: which tasks they hold, how long they have been out, and which of them have a twin."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from shift3d.sweep.ray_crew import Member

__all__ = ["Call", "Calls"]

# A call that takes this many times as long as is usual is given out a second time, once a worker idles for nothing.
_STRAGGLES = 3.0


@dataclass(eq=False)
class Call:
    """Tasks in a worker's hands. attempt: the number of this try. twin: the same tasks in another worker's hands."""

    reference: Any
    member: Member
    positions: list[int]
    attempt: int
    began: float = field(default_factory=time.monotonic)
    began_unix_s: float = field(default_factory=time.time)
    twin: Call | None = None
    # Asked where it is: the answer to come and since when, and when to ask again.
    question: Any = None
    asked: float = 0.0
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

    def __iter__(self) -> Any:
        return iter(self.live())

    def live(self) -> list[Call]:
        """Calls whose result is waited for, the oldest first."""
        return [call for call in self._by_reference.values() if call.reference not in self._superseded]

    @property
    def references(self) -> list[Any]:
        """Of every call, those that another one has superseded included."""
        return list(self._by_reference)

    def add(self, call: Call) -> None:
        """A call was given out."""
        call.member.running = True
        self._by_reference[call.reference] = call

    def pop(self, reference: Any) -> tuple[Call, bool]:
        """A call that ended, and whether its result is wanted: the first of two twins has it."""
        call = self._by_reference.pop(reference)
        call.member.running = False
        wanted = reference not in self._superseded
        self._superseded.discard(reference)
        return call, wanted

    def finished(self, call: Call, tasks: int, seconds: float) -> None:
        """A call gave its result: its twin's is not wanted any more. tasks, seconds: what it ran, for `straggler`."""
        if call.twin is not None and call.twin.reference in self._by_reference:
            self._superseded.add(call.twin.reference)
        if tasks:
            self._per_task_s = [*self._per_task_s[-99:], seconds / tasks]

    def twin_of(self, call: Call) -> Call | None:
        """The twin that is still in flight."""
        return call.twin if call.twin is not None and call.twin.reference in self._by_reference else None

    def straggler(self) -> Call | None:
        """The call that is out longest beyond what is usual and has no twin yet."""
        if not self._per_task_s:
            return None
        usual = sorted(self._per_task_s)[len(self._per_task_s) // 2]
        for call in self.live():
            if call.twin is None and call.seconds > max(_STRAGGLES * usual * len(call.positions), self._least_s):
                return call
        return None
