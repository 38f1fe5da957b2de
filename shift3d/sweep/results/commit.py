"""Commits of outcomes: few enough that a no-op task stays cheap, frequent enough that a kill loses little."""

from __future__ import annotations

import time

import pyarrow as pa

from shift3d.store.log import CommitLog
from shift3d.store.schemas import SEGMENTS
from shift3d.sweep.execution.worker import BatchOutcome

# Approximate memory limit of uncommitted results, whatever commit_seconds is.
_MOST_BYTES = 64 * 2**20


class Committer:
    """Collector that commits outcomes.

    Args: log: the sweep's log. every_s: time since the last commit after which the next one is due.
    """

    def __init__(self, log: CommitLog, every_s: float) -> None:
        self._log = log
        self._every_s = every_s
        self._last = time.monotonic()
        self._clear()

    def _clear(self) -> None:
        self._done: list[str] = []
        self._quarantined: list[str] = []
        self._tables: dict[str, list[pa.Table]] = {name: [] for name in SEGMENTS}
        self._bytes = 0

    def add(self, outcome: BatchOutcome) -> None:
        """Add an outcome, and commit if a commit is due.

        Raises: TakenOverError, InputError: see ``CommitLog.commit``.
        """
        self._done += outcome.done
        self._quarantined += outcome.quarantined
        for name, table in outcome.tables.items():
            if table.num_rows:
                self._tables[name].append(table)
                self._bytes += table.nbytes
        if time.monotonic() - self._last >= self._every_s or self._bytes > _MOST_BYTES:
            self.flush()

    def flush(self) -> None:
        """Commit the collected outcomes. Raises as :meth:`add`."""
        if not (self._done or self._quarantined or any(self._tables.values())):
            return  # the clock keeps running for the next result
        self._last = time.monotonic()
        tables = {name: pa.concat_tables(parts) for name, parts in self._tables.items() if parts}
        self._log.commit(tuple(self._done), tuple(self._quarantined), tables)
        self._clear()
