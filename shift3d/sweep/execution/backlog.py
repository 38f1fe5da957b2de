"""Which tasks wait, how often each was tried, and how many a call to a worker gets: by position in the plan.

Neighbours in a plan share a vehicle, and what a worker prepares for that vehicle takes about as long as a task. So each
worker has a stretch of the plan to itself, and takes half of the longest one that is left when it has ended its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Sequence

import numpy as np

# A task is quarantined after so many failures of a worker in which it was alone.
_CHARGES = 2
# A lost machine is not counted against the task, but so many lost machines are.
_LOSSES = 6
# Of a call.
_MOST_TASKS = 4096


class Backlog:
    """The tasks of a run that have no outcome yet and are in no worker's hands.

    Args: positions: to run, in this order. tried: attempts of earlier runs by position, so that numbers go on.
    """

    def __init__(self, positions: Sequence[int] | np.ndarray, tried: dict[int, int] | None = None) -> None:
        self._positions = np.asarray(positions, dtype=np.int64)
        # By worker: from and up to which of the positions its stretch goes. At first no worker owns any.
        self._stretches: dict[Hashable, tuple[int, int]] = {None: (0, len(self._positions))}
        self._again: deque[int] = deque()
        self._alone: deque[int] = deque()
        self._tries = dict(tried or {})
        self._charges: dict[int, int] = {}
        self._losses: dict[int, int] = {}

    def __len__(self) -> int:
        waiting = sum(end - start for start, end in self._stretches.values())
        return waiting + len(self._again) + len(self._alone)

    def take(self, size: int, worker: Hashable = None) -> list[int]:
        """The next tasks for a worker, at most ``size``: one where it is to be alone. Those that come back go first."""
        if self._alone:
            return [self._alone.popleft()]
        taken = [self._again.popleft() for _ in range(min(size, len(self._again)))]
        if len(taken) < size:
            start, end = self._stretch_of(worker)
            upto = min(start + size - len(taken), end)
            taken += self._positions[start:upto].tolist()
            self._stretches[worker] = (upto, end)
        return taken

    def _stretch_of(self, worker: Hashable) -> tuple[int, int]:
        """A worker's own stretch; where that has ended the later half of the longest, or all of an unowned one."""
        start, end = self._stretches.get(worker, (0, 0))
        if start < end:
            return start, end
        owner = max(self._stretches, key=lambda of: self._stretches[of][1] - self._stretches[of][0])
        start, end = self._stretches[owner]
        middle = start if owner is None else (start + end) // 2
        self._stretches[owner] = (start, middle)
        return middle, end

    def first_attempt(self, positions: Sequence[int]) -> int:
        """The number of the next try of tasks that are tried together: above that of every earlier one."""
        return 1 + max((self._tries.get(position, 0) for position in positions), default=0) if self._tries else 1

    def tried(self, positions: Sequence[int], attempt: int) -> None:
        """An attempt without a result took place."""
        for position in positions:
            self._tries[position] = max(attempt, self._tries.get(position, 0))

    def failed(self, positions: Sequence[int], culprit: int | None, charged: bool, apart: bool, copied: bool) -> bool:
        """Puts the tasks of a call without a result back. True where the culprit is to be quarantined instead.

        culprit: the task that did it, where that is known; it is run again alone. charged: the worker died or hung,
        and the second time quarantines; otherwise a machine went away, and the sixth time does. apart: each of the
        others is run again alone. copied: a speculative copy of the call still runs. It may succeed, so that nothing
        is put back and nothing quarantined until it ends.
        """
        quarantined = culprit is not None and self._counted(culprit, charged) and not copied
        if not copied:
            others = [position for position in positions if position != culprit]
            (self._alone if apart else self._again).extend(others)
            if culprit is not None and not quarantined:
                self._alone.append(culprit)
        return quarantined

    def _counted(self, position: int, charged: bool) -> bool:
        counts, most = (self._charges, _CHARGES) if charged else (self._losses, _LOSSES)
        counts[position] = counts.get(position, 0) + 1
        return counts[position] >= most


class BatchSizer:
    """Grows from one task towards ``seconds`` of work a call, by what calls have taken so far.

    Args: seconds: aim for one call.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._per_task_s: float | None = None
        self._last = 1

    def size(self, left: int, workers: int) -> int:
        """Tasks for the next call. left: tasks not yet given out; the last ones are shared out evenly."""
        fair = -(-left // max(workers, 1))
        if self._per_task_s is None:
            return 1
        wanted = int(self._seconds / max(self._per_task_s, 1e-7))
        # At most eight times the last size, so that one lucky task does not fix the size for all.
        self._last = max(1, min(wanted, 8 * self._last, _MOST_TASKS))
        return max(1, min(self._last, fair))

    def finished(self, tasks: int, seconds: float) -> None:
        """Learn from a call: how many tasks, and how long it took."""
        if tasks:
            new = seconds / tasks
            self._per_task_s = new if self._per_task_s is None else 0.5 * self._per_task_s + 0.5 * new
