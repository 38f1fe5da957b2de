"""Migration of older schema versions on reading: one step from each version to the next.

Files are never rewritten. A sweep that an older program began continues in the same folder, whose files then have
several versions. Rows and ids mean the same in all versions, so the sweep keeps its name and its results.

Source: our choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from shift3d.errors import InputError
from shift3d.store.schemas import SCHEMA_VERSION

Values = dict[str, Any]


def _ids_as_text(values: Values) -> Values:
    """Convert to version 6: task ids are one text, so that a log of a million ids is read in one second."""
    lists = {name: values[name] for name in ("done", "quarantined")}
    if not all(isinstance(ids, list) for ids in lists.values()):
        raise ValueError("ids are no list")
    return {**values, **{name: " ".join(ids) for name, ids in lists.items()}}


def _judged_by_sides(name: str, table: pa.Table) -> pa.Table:
    """Convert to version 9, which measures naturalness: its columns are null, and the older rule's verdict is dropped.

    Version 6 already lacks `volume_share` and `mirrored`.
    """
    if name == "scores":
        return _with_nulls(table, "depth_error_max_m", _NATURALNESS)
    if name != "shapes":
        return table
    gone = [column for column in ("volume_share", "mirrored", "still_a_car") if column in table.column_names]
    table = _with_nulls(table.drop_columns(gone), "height_m", _SIZES)
    return _with_nulls(table, "largest_piece", _NEAREST)


_NATURALNESS = {
    "surface_distance_cm": pa.float64(),
    "surface_distance_p95_cm": pa.float64(),
    "naturalness_percentile": pa.float64(),
    "natural": pa.bool_(),
}
_SIZES = {"clearance_m": pa.float64(), "asymmetry_cm": pa.float64()}
_NEAREST = {
    "nearest_member": pa.string(),
    "to_member_cm": pa.float64(),
    "to_member_p95_cm": pa.float64(),
    "from_member_cm": pa.float64(),
    "from_member_p95_cm": pa.float64(),
    "out_of_range": pa.list_(pa.string()),
}


def _with_nulls(table: pa.Table, after: str, columns: Mapping[str, pa.DataType]) -> pa.Table:
    """Return the table with columns of nulls after the column `after`."""
    place = table.column_names.index(after) + 1
    for offset, (column, kind) in enumerate(columns.items()):
        table = table.add_column(place + offset, column, pa.nulls(len(table), kind))
    return table


def _searched_by_descent(name: str, table: pa.Table) -> pa.Table:
    """Convert to version 8: it stores the search, which was the paper's descent in all older versions."""
    place = table.schema.get_field_index("accuracy")
    if place < 0:
        return table
    words = pa.array(["descent"] * len(table), pa.string())
    return table.add_column(place + 1, pa.field("search", pa.string(), nullable=False), words)


def _to_version_10(name: str, table: pa.Table) -> pa.Table:
    """Convert to version 10: it searches over kinds; older codes are drawn in the frame of the task's vehicle."""
    return _with_nulls(table, "replicate", {"drawn_as": pa.string()}) if name == "solutions" else table


def _random_of_equal_budget(name: str, table: pa.Table) -> pa.Table:
    """Convert to version 11: random_budget names the best of as many draws as the search's evaluation budget."""
    place = table.schema.get_field_index("method")
    if place < 0:
        return table
    methods = table["method"]
    methods = pc.if_else(pc.equal(methods, "random_search"), "random_budget", methods)
    return table.set_column(place, table.schema.field(place), methods)


OLDEST_VERSION = 5
# Converters to the next version, by version. Version 7 added columns to one table; version 9 drops all of them.
_ENTRIES: Mapping[int, Callable[[Values], Values]] = {5: _ids_as_text}
_TABLES: Mapping[int, Callable[[str, pa.Table], pa.Table]] = {
    7: _searched_by_descent,
    8: _judged_by_sides,
    9: _to_version_10,
    10: _random_of_equal_budget,
}


def current_entry(values: Values, where: str) -> Values:
    """Migrate a log entry. Raises as `older_versions`; ValueError or KeyError for values that no program wrote."""
    for version in older_versions(values["schema_version"], where):
        values = _ENTRIES[version](values) if version in _ENTRIES else values
    return values


def current_table(name: str, table: pa.Table, version: str, where: str) -> pa.Table:
    """Migrate the table `name`, except its metadata. Raises as `current_entry`."""
    for number in older_versions(int(version) if version.isdecimal() else version, where):
        table = _TABLES[number](name, table) if number in _TABLES else table
    return table


def older_versions(version: object, where: str) -> range:
    """Return the versions from `version` up to the one before the current; empty for the current version.

    Raises: InputError: the version is newer than this program, or older than the oldest that it reads.
    """
    if isinstance(version, int) and OLDEST_VERSION <= version <= SCHEMA_VERSION:
        return range(version, SCHEMA_VERSION)
    newer = isinstance(version, int) and version > SCHEMA_VERSION
    what = f"has schema version {str(version)[:20]}, this program reads {OLDEST_VERSION} to {SCHEMA_VERSION}"
    remedy = "Use a newer shift3d" if newer else "Use the version of shift3d that wrote it"
    raise InputError(what, where=where, remedy=remedy)
