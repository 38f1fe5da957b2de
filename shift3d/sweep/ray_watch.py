"""Tasks that hang: a worker that is at one task for longer than allowed is asked where it is, and ended."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from shift3d.sweep.ray_calls import Call
from shift3d.sweep.ray_deaths import Death
from shift3d.sweep.ray_worker import BESIDE, Whereabouts

__all__ = ["Hang", "Watch"]

# A worker that gives no answer for so long holds its interpreter, is stopped, or is gone.
_ANSWER_S = 10.0
_LOOK_S = 0.5


@dataclass(frozen=True)
class Hang:
    """A call whose worker is to be ended. position: of the task that hangs; None where the worker could not say."""

    call: Call
    position: int | None
    death: Death


class Watch:
    """Finds calls that hang. timeout_s: of one task, None for any time at all."""

    def __init__(self, ray: Any, timeout_s: float | None) -> None:
        self._ray = ray
        self._timeout_s = timeout_s
        self._looked = 0.0

    def hanging(self, calls: Iterable[Call]) -> list[Hang]:
        """Those of the calls that hang. It asks and does not wait: an answer comes at a later look."""
        if self._timeout_s is None or time.monotonic() - self._looked < _LOOK_S:
            return []
        self._looked = time.monotonic()
        found = (self._look(call, self._timeout_s) for call in calls if call.seconds > self._timeout_s)
        return [hang for hang in found if hang]

    def _look(self, call: Call, timeout_s: float) -> Hang | None:
        now = time.monotonic()
        if call.question is None:
            if call.ask_at == float("inf") or now >= call.ask_at:
                ask = call.member.actor.whereabouts.options(concurrency_group=BESIDE)
                call.question, call.asked = ask.remote(), now
            return None
        ready, _ = self._ray.wait([call.question], timeout=0)
        if ready:
            return self._answered(call, timeout_s)
        if now - call.asked < _ANSWER_S:
            return None
        what = f"no result after {call.seconds:.0f} s, and the worker does not say where it is"
        alone = call.positions[0] if len(call.positions) == 1 else None
        return Hang(call, alone, Death("timeout", what))

    def _answered(self, call: Call, timeout_s: float) -> Hang | None:
        try:
            at: Whereabouts = self._ray.get(call.question)
        except self._ray.exceptions.RayError:
            call.ask_at = float("inf")  # it is dead: the call itself will say so
            call.question = None
            return None
        call.question = None
        if at.index is None or at.seconds < timeout_s:
            call.ask_at = time.monotonic() + (timeout_s if at.index is None else timeout_s - at.seconds)
            return None
        what = f"no result after {at.seconds:.0f} s (runner.task_timeout_s={timeout_s:g})"
        return Hang(call, call.positions[at.index], Death("timeout", what, at.stack))
