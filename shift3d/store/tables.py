"""Conversion of rows to Arrow tables, and Parquet files whose bytes depend only on the table's content."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from shift3d.errors import InputError
from shift3d.store.location import LocalLocation
from shift3d.store.migrations import current_table
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMA_VERSION, SCHEMAS

_ROW_GROUP = 65_536
_RESTORE = "Restore it from a copy, or remove the output folder and run the sweep again"


def table_from_rows(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return rows as a table of the sweep schema ``name``. Raises ValueError as `table_of`."""
    return table_of(SCHEMAS[name], rows)


def table_of(schema: pa.Schema, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return rows of plain Python or NumPy values as a table of a schema; rows may omit nullable columns.

    Raises: ValueError: a row has an unknown column, lacks a non-nullable one, or holds NaN, infinity or a value of
    another type. The task is at fault, so the message names the column and no file.
    """
    name, names = schema.metadata[b"shift3d.schema"].decode(), set(schema.names)
    for row in rows:
        if not names.issuperset(row):
            raise ValueError(f"{name} has no column {sorted(set(row) - names)}")
    columns = [_column(name, field, [row.get(field.name) for row in rows]) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def _column(name: str, field: pa.Field, values: list[Any]) -> pa.Array:
    values = [value.item() if isinstance(value, np.generic) else value for value in values]
    if not field.nullable and any(value is None for value in values):
        raise ValueError(f"{name}.{field.name} is missing in row {values.index(None)}")
    try:
        array = pa.array(values, type=field.type)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise ValueError(f"{name}.{field.name}: {error}") from error
    if pa.types.is_floating(field.type):
        bad = array.filter(pc.invert(pc.is_finite(array)))  # drops nulls
        if len(bad):
            raise ValueError(f"{name}.{field.name} is {bad[0]}")
    return array


def write_table(path: LocationLike, table: pa.Table) -> None:
    """Write a Parquet file atomically. Equal tables give equal bytes.

    Raises: InputError: the disk is full or not writable.
    """
    # One chunk and fixed row groups, so that threads do not influence the bytes.
    as_location(path).write_atomic(parquet_bytes(table.combine_chunks(), row_group_size=_ROW_GROUP))


def parquet_bytes(table: pa.Table, **options: Any) -> bytes:
    """Return a table as compressed Parquet with checksums: without them, a flipped bit would be read as other numbers.

    options: of pyarrow's `write_table`.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True, **options)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def parquet_table(source: Any, columns: Sequence[str] | None = None) -> pa.Table:
    """Read columns of a Parquet file, all by default. source: path, or pyarrow's reader of bytes.

    Bytes are read in one thread: threads of pyarrow keep references to them for a while, and a program that ends in
    the meantime aborts. `pq.read_table` reads ahead in such threads, also with ``use_threads=False``.
    """
    with pq.ParquetFile(source, page_checksum_verification=True) as file:
        return file.read(columns, use_threads=not isinstance(source, pa.NativeFile))


def read_table(
    path: LocationLike, name: str, content: bytes | None = None, read: Callable[[Any], pa.Table] = parquet_table
) -> pa.Table:
    """Read a Parquet file, migrate it to `SCHEMA_VERSION`, and check that it has the schema ``name``.

    content: bytes of the file, if the caller has them. read: reads rows with all columns from a source for pyarrow.
    Raises: InputError: the file is missing, torn, or of another schema or an unreadable version.
    """
    table, found, version = read_parquet(path, _RESTORE, content, read)
    if found != name:
        raise InputError(f"is not a {name} table", where=str(path), remedy=_RESTORE)
    if version != str(SCHEMA_VERSION):
        table = current_table(name, table, version, str(path)).replace_schema_metadata(SCHEMAS[name].metadata)
    check_table(table, SCHEMAS[name], path)
    return table


def read_final(folder: LocationLike, name: str) -> pa.Table:
    """Read a table of a sweep's ``final/``. Raises InputError as `read_table`, or if the sweep has not finished."""
    path = as_location(folder) / "final" / f"{name}.parquet"
    if not path.is_file():
        # A second driver would stop the first.
        status = f"shift3d sweep status {shlex.quote(str(folder))} says whether it still runs"
        remedy = f"{status}; if not, run its command again: it resumes"
        raise InputError("the sweep is not finished", str(folder), remedy)
    return read_table(path, name)


def read_parquet(
    path: LocationLike, remedy: str, content: bytes | None = None, read: Callable[[Any], pa.Table] = parquet_table
) -> tuple[pa.Table, str, str]:
    """Read a Parquet file of shift3d. Return the table, and the schema name and version from its metadata.

    content, read: see `read_table`. Raises: InputError with the remedy: the file is missing or torn.
    """
    location = as_location(path)
    try:
        source: Any = pa.BufferReader(content) if content is not None else None
        if source is None:
            # Absolute: pyarrow takes a relative path with a colon, such as run:1/a.parquet, for a URI.
            there = location.path.absolute() if isinstance(location, LocalLocation) else None
            source = there or pa.BufferReader(location.read_bytes())
        table = read(source)
        table = table.select(table.column_names)  # raises if a damaged column name is no text
    except FileNotFoundError as error:
        raise InputError("is missing", str(path), remedy) from error
    except (OSError, pa.ArrowException, ValueError, KeyError) as error:  # a damaged header raises any of these
        raise InputError(f"cannot be read as Parquet ({type(error).__name__})", str(path), remedy) from error
    metadata = table.schema.metadata or {}
    schema, version = (
        metadata.get(f"shift3d.{key}".encode(), b"none").decode(errors="replace")[:40]
        for key in ("schema", "schema_version")
    )
    return table, schema, version


def check_table(table: pa.Table, schema: pa.Schema, path: LocationLike, remedy: str = _RESTORE) -> None:
    """Refuse a table whose columns or types differ from a schema, that lacks values, or that holds NaN or infinity.

    Raises: InputError: naming the file and the column.
    """
    if table.schema.names != schema.names:
        lacking = [name for name in schema.names if name not in table.schema.names]
        what = f"has no column {lacking[0]}" if lacking else "has not the columns of its kind"
        raise InputError(what, str(path), remedy)
    for field in schema:
        column, found = table[field.name], table.schema.field(field.name)
        if (found.type, found.nullable) != (field.type, field.nullable) or (column.null_count and not field.nullable):
            raise InputError(f"{field.name} is {found.type}, or lacks values", str(path), remedy)
        if pa.types.is_floating(field.type) and not np.isfinite(column.drop_null().to_numpy()).all():
            raise InputError(f"{field.name} holds NaN or infinity", str(path), remedy)
