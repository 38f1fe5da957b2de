"""Which tasks wait, which wait to be run alone, and how often each was tried: by position in the plan."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

__all__ = ["Backlog"]

# A task that was alone in a worker each time that it died is given up on after so many deaths.
_CHARGES = 2
# What is nobody's fault is not charged, but a task that loses this many machines has something to do with it.
_LOSSES = 6


class Backlog:
    """The tasks of a run that have no outcome yet and are in no worker's hands.

    Args:
        positions: to run, in this order. tried: attempts of earlier runs by position, so that numbers go on.
    """

    def __init__(self, positions: Sequence[int] | np.ndarray, tried: dict[int, int] | None = None) -> None:
        self._positions = np.asarray(positions, dtype=np.int64)
        self._next = 0
        self._again: deque[int] = deque()
        self._alone: deque[int] = deque()
        self._tries = dict(tried or {})
        self._charges: dict[int, int] = {}
        self._losses: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._positions) - self._next + len(self._again) + len(self._alone)

    def take(self, size: int) -> list[int]:
        """The next tasks, at most ``size``: one where it is to be alone. Those that come back go first."""
        if self._alone:
            return [self._alone.popleft()]
        taken = [self._again.popleft() for _ in range(min(size, len(self._again)))]
        upto = min(self._next + size - len(taken), len(self._positions))
        taken += self._positions[self._next : upto].tolist()
        self._next = upto
        return taken

    def first_attempt(self, positions: Sequence[int]) -> int:
        """The number of the next try of tasks that are tried together: above that of every earlier one."""
        return 1 + max((self._tries.get(position, 0) for position in positions), default=0) if self._tries else 1

    def tried(self, positions: Sequence[int], attempt: int) -> None:
        """An attempt without a result took place."""
        for position in positions:
            self._tries[position] = max(attempt, self._tries.get(position, 0))

    def charge(self, position: int) -> bool:
        """A worker died with this task alone in it. True where the task is to be given up on."""
        self._charges[position] = self._charges.get(position, 0) + 1
        return self._charges[position] >= _CHARGES

    def lose(self, position: int) -> bool:
        """The machine under this task went away, which is not charged. True where it did so too often to be chance."""
        self._losses[position] = self._losses.get(position, 0) + 1
        return self._losses[position] >= _LOSSES

    def put_back(self, positions: Sequence[int], alone: bool) -> None:
        """Tasks to be run again. alone: each without others, since one of them may have ended its worker."""
        (self._alone if alone else self._again).extend(positions)
