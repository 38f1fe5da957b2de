"""The commit log: numbered JSON files that are the only truth about what is done.

One driver appends. Entry n is created only if absent, so of two drivers one is stopped at its next commit.
Each driver opens with a session entry, which stops any earlier driver that is still alive. A compaction writes an entry
that stands for all before it; sessions before it are kept, since they are what stops a driver that slept meanwhile.

Source: our choice (design section 9).
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.store.location import Location, UncertainError
from shift3d.store.migrations import steps
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMA_VERSION, SEGMENTS
from shift3d.store.tables import write_table

__all__ = ["Commit", "CommitLog", "TakenOverError", "entry_names", "read_entry", "read_log"]

_ENTRY = re.compile(r"\d{8}\.json")
_TRIES = 5
_BEGINNINGS = 50
_RESTORE = "Restore the file from a copy, or remove the output folder and run the sweep again"


class TakenOverError(InputError):
    """Another driver appended to the log: this one must stop, and has lost nothing that it committed."""

    exit_code = ExitCode.TAKEN_OVER


@dataclass(frozen=True)
class Commit:
    """One entry: the tasks it finished, those it gave up on, and the segment files that hold their rows.

    kind: session (a driver began), commit, or compact, which stands for all entries before it.

    segments: table name to file name inside ``data/``. rows: table name to number of rows in that file.
    """

    sequence: int
    kind: str
    driver: str
    spec_hash: str
    done: tuple[str, ...] = ()
    quarantined: tuple[str, ...] = ()
    segments: tuple[tuple[str, str], ...] = ()
    rows: tuple[tuple[str, int], ...] = ()


def read_log(folder: LocationLike) -> list[Commit]:
    """The entries that count, in order: all of them, or from the last compaction on, which says what was before it.

    Raises:
        InputError: an entry is missing, torn, or of a schema version that this program cannot read.
    """
    log = as_location(folder) / "_log"
    for _ in range(_TRIES):
        with contextlib.suppress(FileNotFoundError):  # a compaction has just removed what it replaced
            return _read(log, entry_names(log))
    raise InputError("its entries vanish while they are read", where=str(log), remedy="Run the same command again")


def entry_names(log: Location) -> list[str]:
    """Names of all entries that are there, those that a compaction replaced included, in order. log: the folder _log.

    Raises:
        InputError: a name that no driver gave.
    """
    names = [name for name in log.names() if name.endswith(".json") and name[0].isdigit()]
    for name in names:
        if not _ENTRY.fullmatch(name):
            raise InputError("is no name of a log entry", where=str(log / name), remedy=_RESTORE)
    return names


def _read(log: Location, names: list[str]) -> list[Commit]:
    numbers = [_number(name) for name in names]
    first = len(numbers) - 1
    while first > 0 and numbers[first - 1] == numbers[first] - 1:
        first -= 1
    entries = log.each(lambda name: read_entry(log / name), names[max(first, 0) :])
    compactions = [index for index, entry in enumerate(entries) if entry.kind == "compact"]
    if compactions:
        return entries[compactions[-1] :]
    # Before the last compaction only sessions are left; without one, every entry counts.
    if entries and entries[0].sequence != 0:
        what = f"entry {_entry_name(entries[0].sequence - 1)} is missing"
        raise InputError(what, where=str(log), remedy=_RESTORE)
    return entries


def read_entry(path: Location) -> Commit:
    """One entry.

    Raises:
        FileNotFoundError: it is not there. InputError: it is torn, or of a version that this program cannot read.
    """
    try:
        values = json.loads(path.read_bytes())
        for step in steps(values["schema_version"], str(path)):
            values = step.entry(values)
        return _commit(values, _number(path.name))
    except FileNotFoundError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError("is not a commit log entry", where=str(path), remedy=_RESTORE) from error


def _number(name: str) -> int:
    return int(name.removesuffix(".json"))


def _entry_name(sequence: int) -> str:
    return f"{sequence:08d}.json"


def _commit(values: dict[str, Any], sequence: int) -> Commit:
    """An entry of this version. Raises ValueError where a value cannot be what a driver writes."""
    segments, rows = values["segments"], values["rows"]
    texts = [values["driver"], values["spec_hash"], values["done"], values["quarantined"], *segments.values()]
    wrong = (
        values["kind"] not in ("session", "commit", "compact")
        or not all(isinstance(text, str) for text in texts)
        or not (segments.keys() == rows.keys() <= set(SEGMENTS))
        or not all(type(count) is int and count >= 0 for count in rows.values())
        # A segment lies in data/: an entry names no file elsewhere.
        or any(PurePath(file).name != file for file in segments.values())
    )
    if wrong:
        raise ValueError("not what a driver writes")
    return Commit(
        sequence=sequence,
        kind=values["kind"],
        driver=values["driver"],
        spec_hash=values["spec_hash"],
        done=tuple(values["done"].split()),
        quarantined=tuple(values["quarantined"].split()),
        segments=tuple(segments.items()),
        rows=tuple(rows.items()),
    )


class CommitLog:
    """The log as its one writer sees it.

    Args:
        folder: the sweep's output folder.
        spec_hash: what the sweep is; kept in every entry.

    Attributes:
        entries: all of them, in order.

    Raises:
        InputError: the log cannot be read or written, or is another sweep's.
    """

    def __init__(self, folder: LocationLike, spec_hash: str) -> None:
        self.folder = as_location(folder)
        self.spec_hash = spec_hash
        self.driver = f"{os.getpid()}-{secrets.token_hex(4)}"
        self.entries: list[Commit] = []
        self._done: set[str] = set()
        self._given_up: set[str] = set()
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
        """The session's entry. A driver that is still alive may commit meanwhile: then the next number is tried."""
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

        Args:
            done, quarantined: task ids. tables: segment tables by name; empty ones are left out.

        Raises:
            TakenOverError: another driver wrote this entry; these rows are not part of the sweep.
            InputError: the disk is full; nothing half-written counts.
        """
        written = [self._write(name, table) for name, table in tables.items() if table.num_rows]
        return self._append("commit", done, quarantined, dict(written))

    def compact(self, segment: Callable[[str], pa.Table]) -> Commit:
        """Write an entry that stands for all that are there, with one segment a table.

        segment: the table of everything that was committed, by its name; asked for one after the other.

        Raises:
            As `commit`.
        """
        names = dict.fromkeys(name for entry in self.entries for name, _ in entry.segments)
        written = [self._write(name, segment(name)) for name in names]
        done = dict.fromkeys(task for entry in self.entries for task in entry.done)
        given_up = dict.fromkeys(task for entry in self.entries for task in entry.quarantined)
        left = tuple(task for task in given_up if task not in done)
        entry = self._append("compact", tuple(done), left, dict(written))
        self.entries = [entry]
        return entry

    def _write(self, name: str, table: pa.Table) -> tuple[str, tuple[str, int]]:
        file_name = f"{self._next:08d}-{self.driver}-{name}.parquet"
        write_table(self.folder / "data" / file_name, table)
        return name, (file_name, table.num_rows)

    @property
    def _next(self) -> int:
        return self.entries[-1].sequence + 1 if self.entries else 0

    def _append(
        self,
        kind: str,
        done: tuple[str, ...],
        quarantined: tuple[str, ...],
        segments: dict[str, tuple[str, int]],
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
        path = self.folder / "_log" / _entry_name(sequence)
        try:
            created = path.put_if_absent(json.dumps(values, indent=1).encode() + b"\n")
        except UncertainError:
            raise  # the entry may be there: its segments must stay
        except InputError:
            self._discard(segments)
            raise
        if not created:
            self._discard(segments)
            raise TakenOverError(
                f"another driver took this sweep over ({_driver_of(path)} wrote entry {sequence})",
                where=str(self.folder),
                remedy="Let it finish, or stop it and run the same command again: it resumes",
            )
        self._take(_commit(values, sequence))
        return self.entries[-1]

    def _take(self, entry: Commit) -> None:
        self.entries.append(entry)
        self._done.update(entry.done)
        self._given_up.update(entry.quarantined)

    def _discard(self, segments: dict[str, tuple[str, int]]) -> None:
        for file_name, _ in segments.values():
            (self.folder / "data" / file_name).delete()

    def done(self) -> AbstractSet[str]:
        """Ids of the tasks whose results are committed, up to date for as long as the log is open."""
        return self._done

    def quarantined(self) -> set[str]:
        """Ids of the tasks that were given up on and have not succeeded since."""
        return self._given_up - self._done

    def finished(self) -> set[str]:
        """Ids of the tasks that are not to be run again: those that are done, and those that were given up on."""
        return self._done | self._given_up


def _driver_of(path: Location) -> str:
    try:
        return f"driver {json.loads(path.read_bytes())['driver']}"
    except (OSError, ValueError, KeyError):
        return "it"
