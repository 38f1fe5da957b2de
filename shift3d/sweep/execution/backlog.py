"""Backlog of waiting tasks, by position in the plan: attempts of each task, and the number of tasks per call.

Neighbours in a plan share a vehicle, and a worker prepares a vehicle in about the time of a task. So each worker has
its own contiguous range of the plan; after its end the worker takes half of the longest range left.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Sequence

import numpy as np

# Worker failures with a task alone after which the task is quarantined.
_CHARGES = 2
# A lost machine is not counted against the task, but this many lost machines are.
_LOSSES = 6
_MOST_TASKS = 4096


class Backlog:
    """Tasks of a run without an outcome that no worker holds.

    Args: positions: tasks to run, in this order. tried: attempts of earlier runs by position, so that numbers continue.
    """

    def __init__(self, positions: Sequence[int] | np.ndarray, tried: dict[int, int] | None = None) -> None:
        self._positions = np.asarray(positions, dtype=np.int64)
        # Range (start, end) in `_positions` of each worker. At first all positions belong to the key None.
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
        """Return at most ``size`` tasks for a worker: one that must run alone, or failed ones first, then its range."""
        if self._alone:
            return [self._alone.popleft()]
        taken = [self._again.popleft() for _ in range(min(size, len(self._again)))]
        if len(taken) < size:
            start, end = self._range_of(worker)
            upto = min(start + size - len(taken), end)
            taken += self._positions[start:upto].tolist()
            self._stretches[worker] = (upto, end)
        return taken

    def _range_of(self, worker: Hashable) -> tuple[int, int]:
        """Return a worker's range; at its end the later half of the longest one, or all of the unowned one."""
        start, end = self._stretches.get(worker, (0, 0))
        if start < end:
            return start, end
        owner = max(self._stretches, key=lambda of: self._stretches[of][1] - self._stretches[of][0])
        start, end = self._stretches[owner]
        middle = start if owner is None else (start + end) // 2
        self._stretches[owner] = (start, middle)
        return middle, end

    def first_attempt(self, positions: Sequence[int]) -> int:
        """Return the attempt number for tasks that are tried together: above every earlier one."""
        return 1 + max((self._tries.get(position, 0) for position in positions), default=0) if self._tries else 1

    def tried(self, positions: Sequence[int], attempt: int) -> None:
        """Record an attempt without a result."""
        for position in positions:
            self._tries[position] = max(attempt, self._tries.get(position, 0))

    def failed(self, positions: Sequence[int], culprit: int | None, charged: bool, apart: bool, copied: bool) -> bool:
        """Put the tasks of a failed call back. Return True if the culprit must be quarantined instead.

        culprit: the task that caused the failure, if known; it is run again alone. charged: the worker died or hung,
        which quarantines the culprit the second time; otherwise a machine was lost, which does so the sixth time.
        apart: each other task is run again alone. copied: a speculative copy of the call still runs and may succeed, so
        that nothing is put back or quarantined until the copy ends.
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
    """Number of tasks per call: grows from one towards ``seconds`` of work, by the measured time per task."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._per_task_s: float | None = None
        self._last = 1

    def size(self, left: int, workers: int) -> int:
        """Return the number of tasks for the next call. left: tasks not given out; the last are shared evenly."""
        fair = -(-left // max(workers, 1))
        if self._per_task_s is None:
            return 1
        wanted = int(self._seconds / max(self._per_task_s, 1e-7))
        # At most eight times the last size, so that one fast task does not fix the size for all.
        self._last = max(1, min(wanted, 8 * self._last, _MOST_TASKS))
        return max(1, min(self._last, fair))

    def finished(self, tasks: int, seconds: float) -> None:
        """Update the time per task with a call of `tasks` tasks in `seconds`."""
        if tasks:
            new = seconds / tasks
            self._per_task_s = new if self._per_task_s is None else 0.5 * self._per_task_s + 0.5 * new
