"""Commits of outcomes: few enough that a no-op task stays cheap, frequent enough that a kill loses little."""

from __future__ import annotations

import time
from collections.abc import Callable

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.progress_bar import write_line
from shift3d.store.buckets.object_errors import is_silence
from shift3d.store.log import CommitLog
from shift3d.store.schemas import SEGMENTS
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.wording import duration

# Approximate memory limit of uncommitted results, whatever commit_seconds is, unless a bucket is silent.
_MOST_BYTES = 64 * 2**20
# A silent bucket gets the same commit again, at this interval and for this long.
_RETRY_S = 15.0
_PATIENCE_S = 900.0
_LOOK_S = 0.2


class Committer:
    """Collector that commits outcomes.

    If the bucket is silent, the tasks go on, and the committer tries the same commit again: the same, because its entry
    may exist although no answer came.

    Args: log: the sweep's log. every_s: time since the last commit after which the next one is due.
    """

    def __init__(self, log: CommitLog, every_s: float) -> None:
        self._log = log
        self._every_s = every_s
        self._last = time.monotonic()
        self._retried: tuple[tuple[str, ...], tuple[str, ...], dict[str, pa.Table]] | None = None
        self._silent_since: float | None = None
        self._clear()

    def _clear(self) -> None:
        self._done: list[str] = []
        self._quarantined: list[str] = []
        self._tables: dict[str, list[pa.Table]] = {name: [] for name in SEGMENTS}
        self._bytes = 0

    def add(self, outcome: BatchOutcome) -> None:
        """Add an outcome, and commit if a commit is due.

        Raises: TakenOverError, InputError: see ``CommitLog.commit``; a bucket must be silent for a quarter of an hour.
        """
        self._done += outcome.done
        self._quarantined += outcome.quarantined
        for name, table in outcome.tables.items():
            if table.num_rows:
                self._tables[name].append(table)
                self._bytes += table.nbytes
        waited = time.monotonic() - self._last
        if waited >= _RETRY_S if self._retried else waited >= self._every_s or self._bytes > _MOST_BYTES:
            self._commit()

    def flush(self, given_up: Callable[[], bool] = lambda: False) -> None:
        """Commit the collected outcomes. Raises as :meth:`add`.

        given_up: if true, a silent bucket raises at once.
        """
        while error := self._commit():
            until = time.monotonic() + _RETRY_S
            while time.monotonic() < until:
                if given_up():
                    raise error
                time.sleep(_LOOK_S)

    def _commit(self) -> InputError | None:
        """Commit what was collected, after a commit that is tried again. Return the error of a silent bucket."""
        while self._retried or self._done or self._quarantined or any(self._tables.values()):
            self._last = time.monotonic()  # without results the clock keeps running for the next one
            if not self._retried:
                tables = {name: pa.concat_tables(parts) for name, parts in self._tables.items() if parts}
                self._retried = tuple(self._done), tuple(self._quarantined), tables
                self._clear()
            try:
                self._log.commit(*self._retried)
            except InputError as error:
                if not is_silence(error) or not self._waits(error):
                    raise
                return error
            self._retried = None
            if self._silent_since is not None:
                self._silent_since = None
                write_line("the bucket answers again")
        return None

    def _waits(self, error: InputError) -> bool:
        """Note the silence of the bucket. False if it has lasted too long."""
        if self._silent_since is None:
            self._silent_since = time.monotonic()
            rest = f"The tasks go on; results are committed when it answers, for up to {duration(_PATIENCE_S)}"
            write_line(f"{error.where}: {error.what}. {rest}")
        return time.monotonic() - self._silent_since < _PATIENCE_S
