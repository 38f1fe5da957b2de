"""How many tasks a call to a worker gets: enough for a few seconds, few enough that nobody waits long."""

from __future__ import annotations


class BatchSizer:
    """Grows from one task towards ``seconds`` of work a call, by what calls have taken so far.

    Args: seconds: aim for one call. most: largest batch.
    """

    def __init__(self, seconds: float, most: int = 4096) -> None:
        self._seconds = seconds
        self._most = most
        self._per_task_s: float | None = None
        self._last = 1

    def size(self, left: int, workers: int) -> int:
        """Tasks for the next call. left: tasks not yet given out; the last ones are shared out evenly."""
        fair = -(-left // max(workers, 1))
        if self._per_task_s is None:
            return 1
        wanted = int(self._seconds / max(self._per_task_s, 1e-7))
        # At most eight times the last size, so that one lucky task does not fix the size for all.
        self._last = max(1, min(wanted, 8 * self._last, self._most))
        return max(1, min(self._last, fair))

    def finished(self, tasks: int, seconds: float) -> None:
        """Learn from a call: how many tasks, and how long it took."""
        if tasks:
            new = seconds / tasks
            self._per_task_s = new if self._per_task_s is None else 0.5 * self._per_task_s + 0.5 * new
