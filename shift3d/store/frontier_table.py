"""Table of a measured frontier: cost and errors of each setting in each scene set, one row each."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.store.schemas import schema_of_columns
from shift3d.store.tables import check_table, read_parquet, table_of

FRONTIER_SCHEMA_VERSION = 2
_LACKED_BY_1 = ("start", "grid", "gradient", "ratio_to_paper_chord", "attack_score")
"""Nullable columns that version 1 lacks."""
_AGAIN = "Remove it and run shift3d frontier again"

# `knob`: the parameter, named `knob_name`, in which rows of one method differ. start: cold or warm. grid: an SDF grid
# of the shape is available. gradient: variable (no, shape, pose) whose gradient the timed rendering prepares. hits:
# true hits in all renderings. ms: milliseconds of one rendering, median and quartiles. Ratios: median over that of the
# preset paper as published, and over that of the same preset on the sphere's chord alone; null without it.
# evaluations_per_beam: decoder evaluations over beams through the object's ball. missed_hits to false_hits: fractions
# of true hits; 2cm: of those with a chord of at least 2 cm; false hits can outnumber true ones. depth: errors of hits
# on the right surface. residual: |g| at hits. gradient_cosine, gradient_norm_ratio: gradient of the loss against the
# preset reference. score_delta: mean |final score - with reference|; auc_delta: difference of the mean scores.
# detector_ms: forward and backward; step: a whole attack step. attack_score: mean final score of short attacks on shape
# and pose. pareto: no other usable setting is better in the row's scenes, see shift3d.accuracy_time.pareto.
_COLUMNS = """
setting method knob? knob_name:string? preset:string? start:string? grid:bool? gradient:string? scenes
renders:int64 beams:int64 hits:int64 ms_median:float64 ms_low:float64 ms_high:float64 ratio_to_paper?
ratio_to_paper_chord? evaluations_per_beam:float64 missed_hits:float64 missed_hits_2cm:float64 wrong_surface:float64
false_hits:float64 depth_p50_m:float64 depth_p99_m:float64 depth_max_m:float64 residual_max_m:float64 gradient_cosine?
gradient_norm_ratio? score_delta? auc_delta? detector_ms_median? step_ms_median? step_ratio_to_paper? attack_score?
unresolved_beams:int64 pareto:bool"""
_TEXTS = ("setting", "method", "scenes")
_TYPES = {word.partition(":")[0].removesuffix("?"): "float64" for word in _COLUMNS.split() if word not in _TEXTS}
_PLAIN = schema_of_columns("frontier", FRONTIER_SCHEMA_VERSION, _COLUMNS, _TYPES)
FRONTIER_SCHEMA: pa.Schema = _PLAIN.with_metadata({**_PLAIN.metadata, b"shift3d.machine": b"{}"})


def frontier_table(rows: Sequence[Mapping[str, Any]], machine: Mapping[str, Any] | None = None) -> pa.Table:
    """Return rows of plain Python or NumPy values as the frontier table, ready for ``write_table``.

    machine: processor, cores, torch and threads of the measurement, without a date, so that equal measurements give
    equal bytes. The metadata holds it as JSON under "shift3d.machine".
    Raises: ValueError as `table_of`.
    """
    described = json.dumps(dict(machine or {}), sort_keys=True, separators=(",", ":"), allow_nan=False)
    metadata = {**FRONTIER_SCHEMA.metadata, b"shift3d.machine": described.encode()}
    return table_of(FRONTIER_SCHEMA, rows).replace_schema_metadata(metadata)


def read_frontier(path: Path) -> pa.Table:
    """Read and check ``frontier.parquet``. Columns that an older file lacks are null.

    Raises: InputError: the file is missing, torn, of another schema or version, or lacks a column.
    """
    if not path.is_file():
        raise InputError("no measured frontier", str(path), "Run shift3d frontier first")
    table, schema, version = read_parquet(path, _AGAIN)
    if schema != "frontier" or version not in ("1", str(FRONTIER_SCHEMA_VERSION)):
        what = f"is not a frontier of schema version {FRONTIER_SCHEMA_VERSION} (found {schema}, version {version})"
        raise InputError(what, str(path), "Read it with the version of shift3d that wrote it, or measure again")
    for name in _LACKED_BY_1 if version == "1" else ():
        if name not in table.column_names:
            field = FRONTIER_SCHEMA.field(name)
            table = table.append_column(field, pa.nulls(len(table), field.type))
    found = table.select([name for name in FRONTIER_SCHEMA.names if name in table.column_names])
    check_table(found, FRONTIER_SCHEMA, path, _AGAIN)
    return table


def machine_of(table: pa.Table) -> dict[str, Any]:
    """Return the machine that a frontier was measured on; {} if unknown.

    Raises: InputError: the metadata is no JSON object.
    """
    text = (table.schema.metadata or {}).get(b"shift3d.machine", b"{}").decode(errors="replace")
    try:
        machine = json.loads(text)
    except json.JSONDecodeError:
        machine = None
    if not isinstance(machine, dict):
        raise InputError(f"shift3d.machine is no JSON object ({text[:40]!r})", "frontier metadata", _AGAIN)
    return machine
