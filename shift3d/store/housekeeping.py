"""Clean-up and compaction of a sweep's folder, safe while a driver runs and under a kill at any moment.

Source: our choice (design section 9).
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.log import CommitLog, committed_rows
from shift3d.store.log_entries import Commit, entry_names, read_entry, read_log
from shift3d.store.resolve import LocationLike, as_location

_SEGMENT = re.compile(r"\d{8}-(\d+-[0-9a-f]{8})-\w+\.parquet")


@dataclass(frozen=True)
class Garbage:
    """Files that no reader uses and no driver can commit.

    segments: written by drivers that stopped before their log entry. replaced: log entries that a compaction replaced.
    temporary: half-written by dead processes. unknown: names in data/ of no driver in the log; these files stay.
    """

    segments: tuple[Location, ...]
    replaced: tuple[Location, ...]
    temporary: tuple[Location, ...]
    unknown: tuple[str, ...]

    @property
    def files(self) -> tuple[Location, ...]:
        """All files to remove. Entries come before segments, so that no entry is ever without its segments."""
        return (*self.replaced, *self.segments, *self.temporary)


def find_garbage(folder: LocationLike) -> Garbage:
    """Return the files that `collect` removes.

    The function lists data/ before it reads the log. A listed segment that the log does not name then has one of two
    owners. The driver of the newest entry may still commit its segments, so they stay. Any other driver of the log can
    never commit its segments, so they are garbage. No clock is needed.

    Raises: InputError: the log is damaged; nothing is garbage then.
    """
    folder = as_location(folder)
    log, data = folder / "_log", folder / "data"
    files = data.names()
    entries = read_log(folder)
    if not entries:
        return Garbage((), (), _temporary(folder), tuple(files))
    before = [name for name in entry_names(log) if name < f"{entries[0].sequence:08d}"]
    earlier = [(name, entry) for name, entry in zip(before, log.each(lambda n: _entry(log / n), before)) if entry]
    replaced = [log / name for name, entry in earlier if entry.kind != "session"]
    named = {file for entry in entries for file in entry.segments.values()}
    stopped = {entry.driver for entry in (*entries, *(entry for _, entry in earlier))} - {entries[-1].driver}
    orphans, unknown = [], []
    for name in files:
        found = _SEGMENT.fullmatch(name)
        if name in named or (found and found[1] == entries[-1].driver):
            continue
        if found and found[1] in stopped:
            orphans.append(data / name)
        else:
            unknown.append(name)
    return Garbage(tuple(orphans), tuple(replaced), _temporary(folder), tuple(unknown))


def _temporary(folder: Location) -> tuple[Location, ...]:
    parts = (folder, *(folder / name for name in ("_log", "data", "final")))
    return tuple(file for part in parts for file in part.leftovers())


def _entry(path: Location) -> Commit | None:
    with contextlib.suppress(FileNotFoundError):
        return read_entry(path)
    return None


def collect(garbage: Garbage) -> None:
    """Remove the garbage files."""
    for file in garbage.files:
        file.delete()


@dataclass(frozen=True)
class CompactionResult:
    """Result of a compaction. entries, segments: numbers before it. removed: number of files, log entries included."""

    entries: int
    segments: int
    entry: Commit
    removed: int


def compact(folder: LocationLike) -> CompactionResult:
    """Merge all commits into one log entry and one segment per table. Row order and the bytes of final/ do not change.

    The compaction opens a session, so a running driver stops within seconds. The new entry replaces the old
    segments by the new ones in one step; only then are the old files removed.

    Raises: InputError: the folder has no log, it is damaged, another driver began meanwhile, or the disk is full.
    """
    folder = as_location(folder)
    entries = read_log(folder)
    if not entries:
        raise InputError("has no commit log", where=str(folder), remedy="Give the output folder of a sweep")
    log = CommitLog(folder, entries[-1].spec_hash)
    before = list(log.entries)
    entry = log.compact(lambda name: committed_rows(folder, before, name))
    garbage = find_garbage(folder)
    collect(garbage)
    return CompactionResult(len(entries), sum(len(e.segments) for e in entries), entry, len(garbage.files))
