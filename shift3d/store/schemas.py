"""Arrow schemas of a sweep's tables (design section 5), from ``tables.toml``; their metadata holds the version."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

_FILE = tomllib.loads((Path(__file__).parent / "tables.toml").read_text(encoding="utf-8"))
SCHEMA_VERSION: int = _FILE["version"]
_GROUPS: dict[str, str] = _FILE["groups"]
_COLUMNS = {name: text.partition(", ") for name, text in _FILE["columns"].items()}
COLUMN_MEANINGS: dict[str, str] = {name: meaning for name, (_, _, meaning) in _COLUMNS.items()}
"""Meaning of each column, by name."""
TABLE_DESCRIPTIONS: dict[str, str] = {name: table["about"] for name, table in _FILE["tables"].items()}
"""Description of each table, by name."""


def schema_of_columns(name: str, version: int, columns: str, types: Mapping[str, str] | None = None) -> pa.Schema:
    """Return a schema with its name and version in the metadata.

    columns: ``NAME`` or ``NAME:TYPE``, separated by white space, a question mark after nullable ones; TYPE is Arrow's
    name or ``list-of-TYPE``. types: types of the columns that state none; string for names that it lacks.
    """
    fields = []
    for word in columns.split():
        column, _, stated = word.removesuffix("?").partition(":")
        kind = _type(stated or (types or {}).get(column, "string"))
        fields.append(pa.field(column, kind, nullable=word.endswith("?")))
    return pa.schema(fields, metadata={"shift3d.schema": name, "shift3d.schema_version": str(version)})


def _type(text: str) -> pa.DataType:
    part, is_list = text.removeprefix("list of ").removeprefix("list-of-"), text.startswith("list")
    return pa.list_(pa.type_for_alias(part)) if is_list else pa.type_for_alias(part)


def _without_groups(columns: str) -> Iterator[str]:
    for word in columns.split():
        for part in _GROUPS[word.strip("+?")].split() if word.startswith("+") else [word]:
            yield part.removesuffix("?") + "?" if word.endswith("?") else part


def _names(*groups: str) -> tuple[str, ...]:
    return tuple(name.removesuffix("?") for group in groups for name in _GROUPS[group].split())


SPEC_COLUMNS = _names("task", "settings")
"""Columns that the spec of a task determines; the sweep fills them in."""
POSE_COLUMNS = _names("pose")
"""x, y, z, yaw, pitch and roll of an object, in the order of theta (6,)."""
GROUP_COLUMNS = _names("group")
"""Columns that distinguish the task groups of a curve, an AUC or a grid."""
# Tables that commits write, task by task. A table that a folder lacks is empty: tables added later need no new version,
# and folders without them stay readable.
SEGMENTS = (
    *("scores", "solutions", "timings", "verification", "trajectories", "transfers", "shapes", "vehicle_pool"),
    *("retrieved", "patterns", "attempts"),
)
FOLLOW_UPS = ("verification", "vehicle_pool", "retrieved", "patterns")
"""Tables that separate commands make from a finished sweep."""
SWEEP_TABLES = tuple(name for name in SEGMENTS if name not in FOLLOW_UPS)
"""Tables that the sweep itself makes."""
# Tables computed from the plan and the scores at the end of a sweep.
AGGREGATES = tuple(name for name in _FILE["tables"] if name not in SEGMENTS)
_TYPES = {name: kind for name, (kind, _, _) in _COLUMNS.items()}
SCHEMAS: dict[str, pa.Schema] = {
    name: schema_of_columns(name, SCHEMA_VERSION, " ".join(_without_groups(_FILE["tables"][name]["columns"])), _TYPES)
    for name in (*SEGMENTS, *AGGREGATES)
}
