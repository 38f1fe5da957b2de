"""Arrow schemas of what a sweep writes (design section 5), from ``tables.toml``; their metadata has the version."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

_FILE = tomllib.loads((Path(__file__).parent / "tables.toml").read_text(encoding="utf-8"))
SCHEMA_VERSION: int = _FILE["version"]
_GROUPS: dict[str, str] = _FILE["groups"]
_COLUMNS = {name: text.partition(", ") for name, text in _FILE["columns"].items()}
MEANINGS: dict[str, str] = {name: meaning for name, (_, _, meaning) in _COLUMNS.items()}
"""What each column means, by name."""
ABOUT: dict[str, str] = {name: table["about"] for name, table in _FILE["tables"].items()}
"""What each table holds, by name."""


def schema_of_columns(name: str, version: int, columns: str, types: Mapping[str, str] | None = None) -> pa.Schema:
    """A schema with its name and version in the metadata.

    columns: ``NAME`` or ``NAME:TYPE``, a question mark behind it where it may be null, separated by white space; TYPE
    is Arrow's name, or ``list-of-TYPE``. types: of the columns that have none here; string where it names none.
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
"""Columns that the spec of a task determines: filled in by the sweep."""
POSE_COLUMNS = _names("pose")
"""x, y, z, yaw, pitch and roll of an object, in the order of theta (6,)."""
GROUP_COLUMNS = _names("group")
"""What distinguishes the groups of tasks that a curve, an AUC or a grid is taken over."""
# Written by commits, task by task. A table that a folder does not have is empty: those that came later than the first
# ones need no new version, and folders without them stay readable.
SEGMENTS = (
    *("scores", "solutions", "timings", "verification", "trajectories", "transfers", "shapes", "vehicle_pool"),
    *("retrieved", "patterns", "attempts"),
)
FOLLOW_UPS = ("verification", "vehicle_pool", "retrieved", "patterns")
"""Those that commands of their own make of a sweep that has finished."""
SWEPT = tuple(name for name in SEGMENTS if name not in FOLLOW_UPS)
"""Those that a sweep itself makes."""
# Computed from the plan and the scores when a sweep has finished.
AGGREGATES = tuple(name for name in _FILE["tables"] if name not in SEGMENTS)
_TYPES = {name: kind for name, (kind, _, _) in _COLUMNS.items()}
SCHEMAS: dict[str, pa.Schema] = {
    name: schema_of_columns(name, SCHEMA_VERSION, " ".join(_without_groups(_FILE["tables"][name]["columns"])), _TYPES)
    for name in (*SEGMENTS, *AGGREGATES)
}
