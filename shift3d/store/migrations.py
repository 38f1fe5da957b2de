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
from shift3d.store.schemas import SCHEMA_VERSION, SCHEMAS

Values = dict[str, Any]


def _ids_as_text(values: Values) -> Values:
    """Convert to version 6: task ids are one text, so that a log of a million ids is read in one second."""
    lists = {name: values[name] for name in ("done", "quarantined")}
    if not all(isinstance(ids, list) for ids in lists.values()):
        raise ValueError("ids are no list")
    return {**values, **{name: " ".join(ids) for name, ids in lists.items()}}


OLDEST_VERSION = 5
_ENTRIES: Mapping[int, Callable[[Values], Values]] = {5: _ids_as_text}
"""Converters of log entries to the next version, by version."""
_NATURALNESS = (
    "surface_distance_cm",
    "surface_distance_p95_cm",
    "naturalness_percentile",
    "natural",
    "clearance_m",
    "asymmetry_cm",
    "nearest_member",
    "to_member_cm",
    "to_member_p95_cm",
    "from_member_cm",
    "from_member_p95_cm",
    "out_of_range",
)
_ADDED: Mapping[int, Mapping[str, str | None]] = {
    7: {"search": "descent"},
    8: dict.fromkeys(_NATURALNESS),
    9: {"drawn_as": None},
}
"""Columns that the version after this one adds, with the value that older rows have."""
_DROPPED = {8: ("volume_share", "mirrored", "still_a_car")}
"""Columns that the version after this one drops: the verdict of an older rule. Version 6 lacks the first two."""
_RENAMED_METHODS = {10: ("random_search", "random_budget")}
"""Method that the version after this one renames: the best of as many draws as the search's evaluation budget."""


def current_entry(values: Values, where: str) -> Values:
    """Migrate a log entry. Raises as `older_versions`; ValueError or KeyError for values that no program wrote."""
    for version in older_versions(values["schema_version"], where):
        values = _ENTRIES[version](values) if version in _ENTRIES else values
    return values


def current_table(name: str, table: pa.Table, version: str, where: str) -> pa.Table:
    """Migrate the table `name`, except its metadata. Raises as `current_entry`."""
    names, older = SCHEMAS[name].names, older_versions(int(version) if version.isdecimal() else version, where)
    if not older:
        return table
    for number in older:
        table = table.drop_columns([column for column in _DROPPED.get(number, ()) if column in table.column_names])
        for column, value in _ADDED.get(number, {}).items():
            if column in names and column not in table.column_names:
                field = SCHEMAS[name].field(column)
                table = table.append_column(field, pa.repeat(pa.scalar(value, field.type), len(table)))
        if number in _RENAMED_METHODS and "method" in table.column_names:
            former, current = _RENAMED_METHODS[number]
            place, methods = table.column_names.index("method"), table["method"]
            methods = pc.if_else(pc.equal(methods, former), current, methods)
            table = table.set_column(place, table.schema.field(place), methods)
    known = [column for column in names if column in table.column_names]
    return table.select(known + [column for column in table.column_names if column not in names])


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
