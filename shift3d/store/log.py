"""The commit log: numbered JSON files that are the only truth about what is done.

One driver appends. Entry n is created only if absent, so of two drivers one is stopped at its next commit.
Each driver opens with a session entry, which stops any earlier driver that is still alive.

Source: our choice (design section 9).
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.store.location import Location, Place, UncertainError, as_location
from shift3d.store.schemas import SCHEMA_VERSION, SEGMENTS
from shift3d.store.tables import write_table

__all__ = ["Commit", "CommitLog", "TakenOverError", "read_log"]


class TakenOverError(InputError):
    """Another driver appended to the log: this one must stop, and has lost nothing that it committed."""

    exit_code = 4


@dataclass(frozen=True)
class Commit:
    """One entry: the tasks it finished, those it gave up on, and the segment files that hold their rows.

    segments: table name to file name inside ``data/``. rows: table name to number of rows in that file.
    """

    sequence: int
    kind: str  # session | commit
    driver: str
    spec_hash: str
    done: tuple[str, ...] = ()
    quarantined: tuple[str, ...] = ()
    segments: tuple[tuple[str, str], ...] = ()
    rows: tuple[tuple[str, int], ...] = ()


def read_log(folder: Place) -> list[Commit]:
    """Every entry in order.

    Raises:
        InputError: an entry is missing, torn, or of another schema version.
    """
    log = as_location(folder) / "_log"
    names = [name for name in log.names() if name.endswith(".json") and name[0].isdigit()]
    return log.each(lambda item: _read_entry(log, *item), list(enumerate(names)))


def _read_entry(log: Location, sequence: int, name: str) -> Commit:
    remedy = "Restore the file from a copy, or remove the output folder and run the sweep again"
    path = log / name
    if name != _entry_name(sequence):
        raise InputError(f"entry {_entry_name(sequence)} is missing", where=str(log), remedy=remedy)
    try:
        values = json.loads(path.read_bytes())
        version = values["schema_version"]
        if version == SCHEMA_VERSION:
            return _commit(values, sequence)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError("is not a commit log entry", where=str(path), remedy=remedy) from error
    raise InputError(
        f"has schema version {version}, this is version {SCHEMA_VERSION}",
        where=str(path),
        remedy="Finish it with the version of shift3d that began it, or choose another folder with out=DIR",
    )


def _entry_name(sequence: int) -> str:
    return f"{sequence:08d}.json"


def _commit(values: dict[str, Any], sequence: int) -> Commit:
    """An entry of this version. Raises ValueError where a value cannot be what a driver writes."""
    segments, rows = values["segments"], values["rows"]
    texts = [values["driver"], values["spec_hash"], *values["done"], *values["quarantined"], *segments.values()]
    wrong = (
        values["kind"] not in ("session", "commit")
        or not all(isinstance(value, list) for value in (values["done"], values["quarantined"]))
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
        done=tuple(values["done"]),
        quarantined=tuple(values["quarantined"]),
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

    def __init__(self, folder: Place, spec_hash: str) -> None:
        self.folder = as_location(folder)
        self.spec_hash = spec_hash
        self.driver = f"{os.getpid()}-{secrets.token_hex(4)}"
        self.entries: list[Commit] = []
        self._done: set[str] = set()
        self._given_up: set[str] = set()
        for part in ("_log", "data", "final"):
            for left in (self.folder / part).leftovers():
                left.delete()
        for entry in read_log(self.folder):
            self._take(entry)
        (self.folder / "_log").check_writable()
        for entry in self.entries:
            if entry.spec_hash != spec_hash:
                what = f"entry {entry.sequence:08d}.json is of another sweep ({entry.spec_hash[:40]!r})"
                raise InputError(
                    what, where=str(self.folder / "_log"), remedy="Restore it from a copy, or use another folder"
                )
        self._append("session", (), (), {})

    def commit(self, done: tuple[str, ...], quarantined: tuple[str, ...], tables: dict[str, pa.Table]) -> Commit:
        """Write the segments, then the entry that makes them count.

        Args:
            done, quarantined: task ids. tables: segment tables by name; empty ones are left out.

        Raises:
            TakenOverError: another driver wrote this entry; these rows are not part of the sweep.
            InputError: the disk is full; nothing half-written counts.
        """
        sequence = len(self.entries)
        segments: dict[str, tuple[str, int]] = {}
        for name, table in tables.items():
            if table.num_rows == 0:
                continue
            file_name = f"{sequence:08d}-{self.driver}-{name}.parquet"
            write_table(self.folder / "data" / file_name, table)
            segments[name] = (file_name, table.num_rows)
        return self._append("commit", done, quarantined, segments)

    def _append(
        self,
        kind: str,
        done: tuple[str, ...],
        quarantined: tuple[str, ...],
        segments: dict[str, tuple[str, int]],
    ) -> Commit:
        sequence = len(self.entries)
        name = _entry_name(sequence)
        values: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "kind": kind,
            "driver": self.driver,
            "spec_hash": self.spec_hash,
            "done": list(done),
            "quarantined": list(quarantined),
            "segments": {name: file for name, (file, _) in segments.items()},
            "rows": {name: rows for name, (_, rows) in segments.items()},
        }
        path = self.folder / "_log" / name
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
