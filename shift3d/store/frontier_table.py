"""The table of a measured frontier: one row per setting and scene set, what it costs and what it gets wrong."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from shift3d.errors import InputError
from shift3d.store.tables import check_table

FRONTIER_SCHEMA_VERSION = 2
_WITHOUT = {1: ("start", "grid", "gradient", "ratio_to_paper_chord", "attack_score")}
"""By older version: the columns that it did not have, all of which may be null."""

_PRESETS = ("draft", "standard", "paper", "reference")
# Column, type, what its values must satisfy; a question mark: may be null.
_COLUMNS: list[tuple[str, pa.DataType, str]] = [
    # What was measured. Rows of one method differ in `knob` alone, whose name is `knob_name`.
    ("setting", pa.string(), "text"),
    ("method", pa.string(), "text"),
    ("knob", pa.float64(), "any?"),
    ("knob_name", pa.string(), "text?"),
    ("preset", pa.string(), "preset?"),
    # Under which conditions: cold or warm, whether an SDF grid of the shape was at hand, and of what (no, shape, pose)
    # it was timed ready to take the gradient.
    ("start", pa.string(), "start?"),
    ("grid", pa.bool_(), "any?"),
    ("gradient", pa.string(), "gradient?"),
    ("scenes", pa.string(), "text"),
    # On how much: true hits in all renderings.
    ("renders", pa.int64(), "not negative"),
    ("beams", pa.int64(), "not negative"),
    ("hits", pa.int64(), "not negative"),
    # Of one rendering: median and quartiles. The ratios are a median over this one: that of the preset paper, as it was
    # published, and that of the same on the sphere's chord alone; null without it.
    ("ms_median", pa.float64(), "positive"),
    ("ms_low", pa.float64(), "positive"),
    ("ms_high", pa.float64(), "positive"),
    ("ratio_to_paper", pa.float64(), "positive?"),
    ("ratio_to_paper_chord", pa.float64(), "positive?"),
    # Decoder evaluations over beams through the object's ball.
    ("evaluations_per_beam", pa.float64(), "not negative"),
    # Fractions of true hits; 2cm: of those whose chord is at least 2 cm. There can be more false hits than true ones.
    ("missed_hits", pa.float64(), "fraction"),
    ("missed_hits_2cm", pa.float64(), "fraction"),
    ("wrong_surface", pa.float64(), "fraction"),
    ("false_hits", pa.float64(), "not negative"),
    # Metres, of hits on the right surface; the residual is |g| at hits.
    ("depth_p50_m", pa.float64(), "not negative"),
    ("depth_p99_m", pa.float64(), "not negative"),
    ("depth_max_m", pa.float64(), "not negative"),
    ("residual_max_m", pa.float64(), "not negative"),
    # Of the loss's gradient, against the preset reference.
    ("gradient_cosine", pa.float64(), "any?"),
    ("gradient_norm_ratio", pa.float64(), "not negative?"),
    # Mean |final score - with reference|, and the difference of the mean scores.
    ("score_delta", pa.float64(), "not negative?"),
    ("auc_delta", pa.float64(), "any?"),
    # The detector forward and backward; a whole attack step.
    ("detector_ms_median", pa.float64(), "positive?"),
    ("step_ms_median", pa.float64(), "positive?"),
    ("step_ratio_to_paper", pa.float64(), "positive?"),
    # Mean final score that short attacks on shape and pose reach: the AUC over them.
    ("attack_score", pa.float64(), "fraction?"),
    ("unresolved_beams", pa.int64(), "not negative"),
    # In its scenes no setting that could be used instead is better; see shift3d.accuracy_time.pareto.
    ("pareto", pa.bool_(), "any"),
]
_KIND = {name: kind.removesuffix("?") for name, _, kind in _COLUMNS}
_ALLOWED: dict[str, Callable[[Any], bool]] = {
    "any": lambda value: True,
    "text": lambda value: bool(value.strip()),
    "preset": lambda value: value in _PRESETS,
    "start": lambda value: value in ("cold", "warm"),
    "gradient": lambda value: value in ("no", "shape", "pose"),
    "positive": lambda value: value > 0,
    "not negative": lambda value: value >= 0,
    "fraction": lambda value: 0 <= value <= 1,
}
# Arrow itself would cut 1.5 hits to 1.
_TYPES: dict[Any, Any] = {pa.string(): str, pa.float64(): (int, float), pa.int64(): int, pa.bool_(): bool}
# Columns that cannot decrease from left to right.
_ORDERED = (("ms_low", "ms_median", "ms_high"), ("depth_p50_m", "depth_p99_m", "depth_max_m"))

FRONTIER_SCHEMA = pa.schema(
    [pa.field(name, kind, nullable=allowed.endswith("?")) for name, kind, allowed in _COLUMNS],
    metadata={
        "shift3d.schema": "frontier",
        "shift3d.schema_version": str(FRONTIER_SCHEMA_VERSION),
        "shift3d.machine": "{}",
    },
)


def frontier_table(rows: Sequence[Mapping[str, Any]], machine: Mapping[str, Any] | None = None) -> pa.Table:
    """Rows of plain Python or NumPy values as the frontier's table, ready for ``write_table``.

    Args:
        rows: one mapping per (setting, scenes); columns that may be null may be left out.
        machine: what the times hold for (processor, cores, torch, threads), without a date, so that the same
            measurement gives the same bytes.

    Returns:
        A table of ``FRONTIER_SCHEMA`` whose metadata holds the machine as JSON under "shift3d.machine".

    Raises:
        InputError: a column is unknown or missing, or holds a value that it cannot; the message names column and row.
    """
    known = set(FRONTIER_SCHEMA.names)
    for number, row in enumerate(rows):
        if not known.issuperset(row):
            raise _refused(f"has no column {sorted(set(row) - known)[0]!r}", number, row)
    arrays = [_column(field, rows) for field in FRONTIER_SCHEMA]
    _check_rows(rows)
    described = json.dumps(dict(machine or {}), sort_keys=True, separators=(",", ":"), allow_nan=False)
    metadata = {**(FRONTIER_SCHEMA.metadata or {}), b"shift3d.machine": described.encode()}
    return pa.Table.from_arrays(arrays, schema=FRONTIER_SCHEMA.with_metadata(metadata))


def _column(field: pa.Field, rows: Sequence[Mapping[str, Any]]) -> pa.Array:
    values = [_plain(row.get(field.name)) for row in rows]
    kind = _KIND[field.name]
    for number, (row, value) in enumerate(zip(rows, values)):
        if value is None:
            if not field.nullable:
                raise _refused(f"{field.name} is missing", number, row)
        elif not isinstance(value, _TYPES[field.type]) or isinstance(value, bool) != pa.types.is_boolean(field.type):
            raise _refused(f"{field.name} is {value!r}, not {field.type}", number, row)
        elif isinstance(value, float) and not math.isfinite(value):
            raise _refused(f"{field.name} is {value}", number, row)
        elif not _ALLOWED[kind](value):
            raise _refused(f"{field.name} is {value!r}, not {kind}", number, row)
    return pa.array(values, type=field.type)


def _check_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """What no column can say for itself: order of quantiles, knobs with names, rows that are there twice."""
    seen: set[tuple[str, Any]] = set()
    for number, row in enumerate(rows):
        for names in _ORDERED:
            for low, high in itertools.pairwise(names):
                if row[low] > row[high]:
                    raise _refused(f"{low} {row[low]:g} is above {high} {row[high]:g}", number, row)
        if (row.get("knob") is None) != (row.get("knob_name") is None):
            raise _refused("knob and knob_name must both be there or both be null", number, row)
        for column in ("setting", "preset"):
            if row.get(column) is None:
                continue
            key = (column, (row[column], row["scenes"]))
            if key in seen:
                raise _refused(f"{column} is in these scenes twice", number, row)
            seen.add(key)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _refused(what: str, number: int, row: Mapping[str, Any]) -> InputError:
    return InputError(what, f"frontier row {number} ({row.get('setting')!r} in {row.get('scenes')!r})")


def read_frontier(path: Path) -> pa.Table:
    """Read ``frontier.parquet`` and check that it holds a frontier; columns that an older one lacks are null.

    Raises:
        InputError: the file is missing, torn, of another schema or version, or lacks a column.
    """
    if not path.is_file():
        raise InputError("no measured frontier", str(path), "Run make frontier first")
    try:
        table = pq.read_table(path, partitioning=None, page_checksum_verification=True)
        table = table.select(table.column_names)  # a damaged name may be no text
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        what = f"cannot be read as Parquet ({type(error).__name__})"
        raise InputError(what, str(path), "Remove it and run make frontier again") from error
    metadata = table.schema.metadata or {}
    schema = metadata.get(b"shift3d.schema", b"none").decode(errors="replace")
    version = metadata.get(b"shift3d.schema_version", b"none").decode(errors="replace")
    table = _completed(table, version)
    if schema != "frontier" or version not in map(str, (*_WITHOUT, FRONTIER_SCHEMA_VERSION)):
        what = f"is not a frontier of schema version {FRONTIER_SCHEMA_VERSION} (found {schema}, version {version})"
        raise InputError(what, str(path), "Read it with the version of shift3d that wrote it, or measure again")
    for field in FRONTIER_SCHEMA:
        if field.name not in table.column_names or table.schema.field(field.name).type != field.type:
            raise InputError(f"has no column {field.name} of type {field.type}", str(path), "Run make frontier again")
    check_table(table.select(FRONTIER_SCHEMA.names), FRONTIER_SCHEMA, path)
    return table


def _completed(table: pa.Table, version: str) -> pa.Table:
    """A table of an older version with the columns that it lacks, all null."""
    for name in _WITHOUT.get(int(version), ()) if version.isascii() and version.isdigit() else ():
        if name not in table.column_names:
            field = FRONTIER_SCHEMA.field(name)
            table = table.append_column(field, pa.nulls(len(table), field.type))
    return table


def machine_of(table: pa.Table) -> dict[str, Any]:
    """The machine that a frontier was measured on, {} where nothing is known of it.

    Raises:
        InputError: the metadata is no JSON object.
    """
    text = (table.schema.metadata or {}).get(b"shift3d.machine", b"{}").decode(errors="replace")
    try:
        machine = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"shift3d.machine is no JSON ({text[:40]!r})", "frontier metadata", "Run make frontier again"
        ) from error
    if not isinstance(machine, dict):
        raise InputError(
            f"shift3d.machine is no JSON object ({text[:40]!r})", "frontier metadata", "Run make frontier again"
        )
    return machine
