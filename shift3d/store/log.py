"""Commit log: numbered JSON files, the only record of the finished tasks.

One driver appends entries. Entry n is created only if absent, so of two drivers one is stopped at its next commit. Each
driver begins with a session entry, which stops every earlier driver that still runs: the earlier driver looks for new
entries between commits, so that long tasks do not delay its end. A compaction writes one entry that replaces all
entries before it; older session entries stay, since they stop a driver that slept meanwhile.

Source: our choice (design section 9).
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.store.atomic import UncertainError
from shift3d.store.location import Location
from shift3d.store.log_entries import Commit, entry_name, entry_of, read_log
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMA_VERSION, SCHEMAS
from shift3d.store.tables import read_table, write_table

_BEGINNINGS = 50


class TakenOverError(InputError):
    """Error after another driver appended to the log: this driver must stop; its commits stay valid."""

    exit_code = ExitCode.TAKEN_OVER


class CommitLog:
    """Commit log of a sweep, opened by its only writer.

    Args:
        folder: output folder of the sweep.
        spec_hash: hash of the sweep, stored in every entry.

    Attributes:
        entries: the entries that count, in order.

    Raises: InputError: the log cannot be read or written, or belongs to another sweep.
    """

    def __init__(self, folder: LocationLike, spec_hash: str) -> None:
        self.folder = as_location(folder)
        self.spec_hash = spec_hash
        self.driver = f"{os.getpid()}-{secrets.token_hex(4)}"
        self.entries: list[Commit] = []
        self._done: set[str] = set()
        self._quarantined: set[str] = set()
        for part in ("_log", "data", "final"):
            for left in (self.folder / part).leftovers():
                left.delete()
        self._read_all()
        (self.folder / "_log").check_writable()
        self._begin()

    def _read_all(self) -> None:
        self.entries = []
        for entry in read_log(self.folder):
            if entry.spec_hash != self.spec_hash:
                what = f"entry {entry.sequence:08d}.json is of another sweep ({entry.spec_hash[:40]!r})"
                remedy = "Restore it from a copy, or use another folder"
                raise InputError(what, where=str(self.folder / "_log"), remedy=remedy)
            self._take(entry)

    def _begin(self) -> None:
        """Append the session entry. If a running driver commits meanwhile, try the next number."""
        for _ in range(_BEGINNINGS):
            try:
                self._append("session", (), (), {})
                return
            except TakenOverError as error:
                failure = error
                self._read_all()
        raise failure

    def commit(self, done: tuple[str, ...], quarantined: tuple[str, ...], tables: dict[str, pa.Table]) -> Commit:
        """Write the segments, then the entry that makes them count.

        Args: done, quarantined: task ids. tables: segment tables by name; empty tables are skipped.

        Raises:
            TakenOverError: another driver wrote this entry; the rows are not part of the sweep.
            InputError: the disk is full, or the folder is gone; no half-written file counts.
        """
        self.check_there()
        written = {name: self._write(name, table) for name, table in tables.items() if table.num_rows}
        return self._append("commit", done, quarantined, written)

    def compact(self, segment: Callable[[str], pa.Table]) -> Commit:
        """Write one entry that replaces all entries, with one segment per table. Raises as `commit`.

        segment: returns all committed rows of the named table; called for one table after the other.
        """
        names = dict.fromkeys(name for entry in self.entries for name in entry.segments)
        written = {name: self._write(name, segment(name)) for name in names}
        done = dict.fromkeys(task for entry in self.entries for task in entry.done)
        listed = dict.fromkeys(task for entry in self.entries for task in entry.quarantined)
        left = tuple(task for task in listed if task not in done)
        entry = self._append("compact", tuple(done), left, written)
        self.entries = [entry]
        return entry

    def _write(self, name: str, table: pa.Table) -> tuple[str, int]:
        file_name = f"{self._next:08d}-{self.driver}-{name}.parquet"
        write_table(self.folder / "data" / file_name, table)
        return file_name, table.num_rows

    @property
    def _next(self) -> int:
        return self.entries[-1].sequence + 1 if self.entries else 0

    def _append(
        self, kind: str, done: tuple[str, ...], quarantined: tuple[str, ...], segments: dict[str, tuple[str, int]]
    ) -> Commit:
        sequence = self._next
        values: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "kind": kind,
            "driver": self.driver,
            "spec_hash": self.spec_hash,
            "done": " ".join(done),
            "quarantined": " ".join(quarantined),
            "segments": {name: file for name, (file, _) in segments.items()},
            "rows": {name: rows for name, (_, rows) in segments.items()},
        }
        path = self.folder / "_log" / entry_name(sequence)
        try:
            created = path.put_if_absent(json.dumps(values, indent=1).encode() + b"\n")
        except UncertainError:
            raise  # the entry may exist, so its segments must stay
        except InputError:
            self._discard(segments)
            raise
        if not created:
            self._discard(segments)
            raise self._taken_over(path)
        self._take(entry_of(values, sequence))
        return self.entries[-1]

    def check_there(self) -> None:
        """Raise InputError if the folder has lost this log: a write would create it again, without earlier entries.

        Another driver's compaction may have removed the first entry, but has added the next one.
        """
        log, first = self.folder / "_log", self.entries[0].sequence
        if not any((log / entry_name(sequence)).is_file() for sequence in (first, self._next)):
            what = f"was removed, renamed or unmounted during the sweep: {entry_name(first)} is gone"
            raise InputError(what, str(log), "Bring the folder back and run the same command again: it resumes")

    def check_own(self) -> None:
        """Raise TakenOverError if another driver has appended an entry; other errors if the store cannot say.

        An entry of this driver is none: a commit whose answer got lost may have written it.
        """
        path = self.folder / "_log" / entry_name(self._next)
        with contextlib.suppress(FileNotFoundError):
            if json.loads(path.read_bytes()).get("driver") != self.driver:
                raise self._taken_over(path)

    def _taken_over(self, path: Location) -> TakenOverError:
        return TakenOverError(
            f"another driver took this sweep over ({_driver_of(path)} wrote entry {self._next})",
            where=str(self.folder),
            remedy="Let it finish, or stop it and run the same command again: it resumes",
        )

    def _take(self, entry: Commit) -> None:
        self.entries.append(entry)
        self._done.update(entry.done)
        self._quarantined.update(entry.quarantined)

    def _discard(self, segments: dict[str, tuple[str, int]]) -> None:
        for file_name, _ in segments.values():
            (self.folder / "data" / file_name).delete()

    def done(self) -> AbstractSet[str]:
        """Return the ids of the tasks with committed results; the set follows later commits of this log."""
        return self._done

    def quarantined(self) -> set[str]:
        """Return the ids of the quarantined tasks that have not succeeded since."""
        return self._quarantined - self._done

    def finished(self) -> set[str]:
        """Return the ids of the tasks that are done or quarantined, and so do not run again."""
        return self._done | self._quarantined


def _driver_of(path: Location) -> str:
    try:
        return f"driver {json.loads(path.read_bytes())['driver']}"
    except (OSError, ValueError, KeyError):
        return "it"


def committed_rows(folder: LocationLike, entries: Sequence[Commit], name: str) -> pa.Table:
    """Return all committed rows of one table, in the order of the log.

    Raises: InputError: a segment is missing, torn, or has another number of rows than was committed.
    """
    files = [(entry.segments[name], entry.rows[name]) for entry in entries if name in entry.segments]
    data = as_location(folder) / "data"
    parts = data.each(lambda file: _segment(data, name, *file), files)
    return pa.concat_tables([SCHEMAS[name].empty_table(), *parts])


def _segment(data: Location, name: str, file_name: str, rows: int) -> pa.Table:
    try:
        part = read_table(data / file_name, name)
    except InputError as error:
        if (data / file_name).is_file():
            raise
        remedy = "If it was compacted meanwhile, run the same command again; else restore it from a copy"
        raise InputError("is missing", where=str(data / file_name), remedy=remedy) from error
    if part.num_rows != rows:
        remedy = "Restore it from a copy, or remove the output folder and run the sweep again"
        raise InputError(f"has {part.num_rows} rows, {rows} were committed", str(data / file_name), remedy)
    return part
