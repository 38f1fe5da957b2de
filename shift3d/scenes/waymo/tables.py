"""Parquet components of a segment: columns by name, rows by all keys, one frame at a time."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.file_checks import opened
from shift3d.store.location import Location

SEGMENT, FRAME, LASER = "key.segment_context_name", "key.frame_timestamp_micros", "key.laser_name"
_ROWS_AT_ONCE = 8  # a row of `lidar` is up to 5 MB
_BUFFER_BYTES = 2**20
_AGAIN = "Copy it again"


@dataclass(frozen=True)
class Component:
    """One component of one segment.

    file: ``{root}/{component}/{segment}.parquet`` in a folder or a bucket. segment: required segment of all rows.
    """

    file: Location
    segment: str

    def timestamps(self) -> list[int]:
        """List the frames that have rows, microseconds, ascending.

        Raises InputError: the file cannot be read, or has no rows.
        """
        with self._opened((SEGMENT, FRAME)) as parquet:
            keys = self._checked(parquet.read(columns=[SEGMENT, FRAME], use_threads=False))
        if not keys.num_rows:
            raise InputError("the table has no rows", str(self.file), f"{_AGAIN}, or remove the segment")
        return [int(value) for value in np.unique(_integers(keys[FRAME], self.file))]

    def rows(self, columns: Sequence[str], timestamp: int | None = None) -> pa.Table:
        """Read the rows of one frame, or all of a component without frames, from the needed columns and row groups.

        Raises InputError: the file cannot be read, lacks a column, has no rows at all, or rows of another segment.
        """
        keys = [SEGMENT] if timestamp is None else [SEGMENT, FRAME]
        wanted = [*keys, *(name for name in columns if name not in keys)]
        with self._opened(wanted) as parquet:
            if not parquet.metadata.num_rows:
                raise InputError("the table has no rows", str(self.file), _AGAIN)
            if timestamp is None:
                return self._checked(parquet.read(columns=wanted, use_threads=False))
            groups = [_rows_at(parquet, group, timestamp, wanted) for group in range(parquet.num_row_groups)]
            schema = pa.schema([parquet.schema_arrow.field(name) for name in wanted])
            return self._checked(pa.Table.from_batches(itertools.chain(*groups), schema=schema))

    @contextlib.contextmanager
    def _opened(self, columns: Sequence[str]) -> Iterator[pq.ParquetFile]:
        """Open the file; errors while it is open become InputErrors of one line.

        Read it in one thread, for the reason that `store.tables.parquet_table` gives.
        """
        with opened(self.file, "Parquet file", pa.ArrowException) as handle:
            parquet = pq.ParquetFile(handle, buffer_size=_BUFFER_BYTES)
            missing = [name for name in columns if name not in parquet.schema_arrow.names]
            if missing:
                raise InputError(f"no column {missing[0]}", str(self.file), "Give version 2 of the data set")
            yield parquet

    def _checked(self, table: pa.Table) -> pa.Table:
        table.validate(full=True)  # its texts may not be UTF-8
        for found in table[SEGMENT].unique().to_pylist():
            if str(found) != self.segment:
                what = f"rows of segment {found!r} in the file of {self.segment!r}"
                raise InputError(what, str(self.file), _AGAIN)
        return table


def _rows_at(parquet: pq.ParquetFile, group: int, timestamp: int, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Read the rows of one frame in a row group without holding the group: the keys are read first."""
    keys = parquet.read_row_group(group, columns=[FRAME], use_threads=False)[FRAME]
    rows = np.flatnonzero(np.asarray(keys.to_numpy()) == timestamp)
    if not len(rows):
        return
    start = 0
    for batch in parquet.iter_batches(_ROWS_AT_ONCE, row_groups=[group], columns=list(columns), use_threads=False):
        inside = rows[(rows >= start) & (rows < start + batch.num_rows)] - start
        if len(inside):
            yield batch.select(list(columns)).take(pa.array(inside))
        start += batch.num_rows
        if start > rows[-1]:
            return


def _integers(column: pa.ChunkedArray, file: Location) -> NDArray[np.int64]:
    if column.null_count or not pa.types.is_integer(column.type):
        raise InputError("key.frame_timestamp_micros is not whole numbers", str(file), _AGAIN)
    result: NDArray[np.int64] = column.to_numpy().astype(np.int64)
    return result


def numbers(value: Any, size: int | None, where: str) -> NDArray[np.float64]:
    """Convert a list of numbers of any width to float64. size: required length, or None.

    Raises InputError: no list of numbers, or another length.
    """
    try:
        found: NDArray[np.float64] = np.asarray(value.values.to_numpy(zero_copy_only=False), np.float64)
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError("no list of numbers", where, _AGAIN) from error
    if size is not None and len(found) != size:
        raise InputError(f"{len(found)} numbers, {size} expected", where, _AGAIN)
    return found


def by_key(table: pa.Table, key: str, where: str) -> Mapping[Any, dict[str, Any]]:
    """Index rows by the values of a key; each row is a dictionary of columns to Arrow scalars.

    Raises InputError: two rows with the same key value.
    """
    found: dict[Any, dict[str, Any]] = {}
    for row in range(table.num_rows):
        value = table[key][row].as_py()
        if value in found:
            raise InputError(f"two rows of {key}={value}", where, _AGAIN)
        found[value] = {name: table[name][row] for name in table.column_names}
    return found
