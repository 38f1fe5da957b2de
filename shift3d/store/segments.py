"""Rows of committed segments, as the log names them."""

from __future__ import annotations

from collections.abc import Sequence

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.log_entries import Commit
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMAS
from shift3d.store.tables import read_table


def committed_rows(folder: LocationLike, entries: Sequence[Commit], name: str) -> pa.Table:
    """Every row of one table that was committed, in the order of the log.

    Raises:
        InputError: a segment is missing, torn, or of another length than was committed.
    """
    files = [(dict(entry.segments)[name], dict(entry.rows)[name]) for entry in entries if name in dict(entry.segments)]
    data = as_location(folder) / "data"
    parts = data.each(lambda file: _segment(data, name, *file), files)
    return pa.concat_tables([SCHEMAS[name].empty_table(), *parts])


def _segment(data: Location, name: str, file_name: str, rows: int) -> pa.Table:
    part = read_table(data / file_name, name)
    if part.num_rows != rows:
        raise InputError(
            f"has {part.num_rows} rows, {rows} were committed",
            where=str(data / file_name),
            remedy="Restore it from a copy, or remove the output folder and run the sweep again",
        )
    return part
