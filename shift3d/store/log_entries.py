"""Reading of the commit log: list the entries, parse each, and select the entries that count.

Source: our choice (design section 9).
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.migrations import current_entry
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SEGMENTS

_ENTRY = re.compile(r"\d{8}\.json")
_TRIES = 5
_RESTORE = "Restore the file from a copy, or remove the output folder and run the sweep again"


@dataclass(frozen=True)
class Commit:
    """One log entry: the tasks it finished, the tasks it quarantined, and the segment files that hold their rows.

    kind: session (a driver began), commit, or compact (replaces all entries before it).

    segments: table name to file name inside ``data/``. rows: table name to number of rows in that file.
    """

    sequence: int
    kind: str
    driver: str
    spec_hash: str
    done: tuple[str, ...]
    quarantined: tuple[str, ...]
    segments: Mapping[str, str]
    rows: Mapping[str, int]


def read_log(folder: LocationLike) -> list[Commit]:
    """Return the entries that count, in order: all entries, or those from the last compaction on.

    Raises: InputError: an entry is missing, torn, or of a schema version that this program cannot read.
    """
    log = as_location(folder) / "_log"
    for _ in range(_TRIES):
        with contextlib.suppress(FileNotFoundError):  # a compaction has just removed replaced entries
            return _read(log, entry_names(log))
    raise InputError("its entries vanish while they are read", where=str(log), remedy="Run the same command again")


def entry_names(log: Location) -> list[str]:
    """Return the sorted names of all entries, including those that a compaction replaced. log: the folder _log.

    Raises: InputError: a name that no driver gives.
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
    # A gap arises only before a compaction. Without one, every entry counts, so the entries begin at 0.
    if entries and entries[0].sequence != 0:
        what = f"entry {entry_name(entries[0].sequence - 1)} is missing"
        raise InputError(what, where=str(log), remedy=_RESTORE)
    return entries


def read_entry(path: Location) -> Commit:
    """Read one entry.

    Raises: FileNotFoundError: no such entry. InputError: it is torn, or of a version that this program cannot read.
    """
    try:
        return entry_of(current_entry(json.loads(path.read_bytes()), str(path)), _number(path.name))
    except FileNotFoundError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError("is not a commit log entry", where=str(path), remedy=_RESTORE) from error


def _number(name: str) -> int:
    return int(name.removesuffix(".json"))


def entry_name(sequence: int) -> str:
    """Return the file name of an entry."""
    return f"{sequence:08d}.json"


def entry_of(values: dict[str, Any], sequence: int) -> Commit:
    """Return the entry with the given JSON values. Raises ValueError if no driver writes the values."""
    segments, rows = values["segments"], values["rows"]
    texts = [values["driver"], values["spec_hash"], values["done"], values["quarantined"], *segments.values()]
    wrong = (
        values["kind"] not in ("session", "commit", "compact")
        or not all(isinstance(text, str) for text in texts)
        or not (segments.keys() == rows.keys() <= set(SEGMENTS))
        or not all(type(count) is int and count >= 0 for count in rows.values())
        # Segments are stored in data/, so a path with a folder is wrong.
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
        segments=segments,
        rows=rows,
    )
