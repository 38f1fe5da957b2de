"""Mutants of a sweep's files: spec, plan, commit log, segments; and of a measured frontier."""

from __future__ import annotations

import copy
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from feeding import InputKind, register
from mutations import Rng, mutate_bytes, mutate_text, pick
from valid_sweeps import FRONTIER, plan, write_frontier, write_sweep
from value_mutations import mutate_values

from shift3d.store.frontier_table import FRONTIER_SCHEMA, machine_of, read_frontier
from shift3d.store.log_entries import read_log
from shift3d.store.schemas import SCHEMAS
from shift3d.store.tables import read_table
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final


def check_table(table: pa.Table, schema: pa.Schema) -> None:
    """Check the schema's columns and types, required values, and that no number is NaN."""
    assert table.schema.names == schema.names and table.schema.types == schema.types
    for field in schema:
        column = table[field.name]
        assert field.nullable or column.null_count == 0, field.name
        if pa.types.is_floating(field.type):
            assert np.isfinite(column.drop_null().to_numpy()).all(), field.name


def mutate_table(table: pa.Table, rng: Rng) -> pa.Table:
    """Change columns (removed, doubled, retyped, renamed, missing or special values), rows or metadata of a table."""
    how = pick(("drop", "rename", "type", "null", "special", "rows", "metadata", "order"), rng)
    index = int(rng.integers(table.num_columns))
    name = table.column_names[index]
    if how == "drop":
        return table.drop_columns([name])
    if how == "rename":
        return table.rename_columns([f"{n}_old" if n == name else n for n in table.column_names])
    if how == "rows":
        return table.slice(0, int(rng.integers(table.num_rows)))
    if how == "order":
        return table.select([*table.column_names[1:], table.column_names[0]])
    if how == "metadata":
        metadata = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
        odd = ("", "0", "99", "other", "\u00e9", "-1", "[")
        return table.replace_schema_metadata({**metadata, str(pick(sorted(metadata), rng)): str(pick(odd, rng))})
    field = table.schema.field(index)
    if how == "special" and pa.types.is_floating(field.type):
        values = [float(pick((np.nan, np.inf, -1e308), rng)), *table[name].to_pylist()[1:]]
        return table.set_column(index, field, pa.array(values, type=field.type))
    if how == "null":
        nothing = pa.nulls(table.num_rows, field.type)
        return table.set_column(index, field.with_nullable(True), nothing)
    return table.set_column(index, name, pa.array([str(value) for value in table[name].to_pylist()]))


def parquet_mutator(find: Callable[[Path, Rng], Path]) -> Callable[[Path, Rng], str]:
    def mutate(folder: Path, rng: Rng) -> str:
        path = find(folder, rng)
        if rng.uniform() < 0.6:
            path.write_bytes(mutate_bytes(path.read_bytes(), rng))
            return f"bytes of {path.name}"
        pq.write_table(mutate_table(pq.read_table(path, partitioning=None), rng), path, compression="zstd")
        return f"table {path.name.rpartition('-')[2]}"

    return mutate


def _segment(folder: Path, rng: Rng) -> Path:
    return Path(pick(sorted((folder / "data").glob("*.parquet")), rng))


def load_segments(folder: Path) -> Any:
    """Load every segment that the log names, and check it."""
    rows = {}
    for entry in read_log(folder):
        for name, file in entry.segments.items():
            table = read_table(folder / "data" / file, name)
            check_table(table, SCHEMAS[name])
            rows[file] = table.num_rows
    return rows


def load_final(folder: Path) -> Any:
    """Load the final tables from the existing files."""
    final = write_final(folder, plan(), read_log(folder))
    for name, table in final.tables.items():
        check_table(table, SCHEMAS[name])
        assert name not in ("scores", "attempts") or set(table["task_id"].to_pylist()) <= TASKS
    return {name: table.num_rows for name, table in final.tables.items()}


TASKS = {task.spec.task_id for task in plan().tasks}


def mutate_log(folder: Path, rng: Rng) -> str:
    path = Path(pick(sorted((folder / "_log").glob("*.json")), rng))
    how = pick(("text", "values", "values", "rename", "copy", "harmless"), rng)
    if how == "text":
        path.write_bytes(mutate_text(path.read_bytes(), rng))
    elif how == "values":
        path.write_text(json.dumps(mutate_values(json.loads(path.read_text()), rng)))
    elif how == "rename":
        path.rename(path.with_name(str(pick(("00000009.json", "1.json", "x.json", "00000000.txt"), rng))))
    elif how == "copy":
        (path.parent / str(pick(("00000003.json", "0000000a.json", ".tmp-1-x.json"), rng))).write_bytes(
            path.read_bytes()
        )
    else:
        path.write_text(json.dumps(json.loads(path.read_text()), sort_keys=True))
    return str(how)


def load_log(folder: Path) -> Any:
    entries = read_log(folder)
    assert [entry.sequence for entry in entries] == list(range(len(entries)))
    for entry in entries:
        assert entry.kind in ("session", "commit") and isinstance(entry.driver, str)
        assert all(isinstance(task, str) for task in (*entry.done, *entry.quarantined))
        rows = dict(entry.rows)
        assert dict(entry.segments).keys() == rows.keys() <= SCHEMAS.keys()
        assert all(type(count) is int and count >= 0 for count in rows.values())
        # A segment must be in data/, whatever the entry says.
        assert all(Path(file).name == file for file in entry.segments.values())
    return [(entry.kind, entry.done, sorted(entry.segments.items()), sorted(entry.rows.items())) for entry in entries]


@functools.cache
def _valid_spec(text: str) -> Any:
    return yaml.safe_load(text)


def mutate_spec(folder: Path, rng: Rng) -> str:
    path = folder / "spec.yaml"
    how = pick(("text", "values", "values", "harmless"), rng)
    if how == "text":
        path.write_bytes(mutate_text(path.read_bytes(), rng))
    else:
        values = copy.deepcopy(_valid_spec(path.read_text()))
        path.write_text(
            yaml.dump(mutate_values(values, rng) if how == "values" else values, sort_keys=how == "harmless")
        )
    return str(how)


def load_plan(folder: Path) -> Any:
    """Load the plan, which the folder's spec is a part of."""
    found = read_plan(folder)
    assert isinstance(found.spec_hash, str) and isinstance(found.sweep, str)
    assert isinstance(found.settings, dict) and isinstance(found.axes, dict)
    assert found.tasks and all(0 <= task.assets < len(found.assets) for task in found.tasks)
    for task in found.tasks:
        assert len(task.spec.task_id) == 32 and task.spec.mode in ("shape", "pose")
    return [task.spec.task_id for task in found.tasks]


def load_frontier(folder: Path) -> Any:
    table = read_frontier(folder / FRONTIER)
    check_table(table.select(FRONTIER_SCHEMA.names), FRONTIER_SCHEMA)
    return table.num_rows, machine_of(table)


HERE = ("_log", "data", "spec.yaml", "plan.parquet", "frontier")
register(InputKind("sweep segments", 150, write_sweep, parquet_mutator(_segment), load_segments, HERE))
register(InputKind("sweep tables", 50, write_sweep, parquet_mutator(_segment), load_final, HERE))
register(InputKind("commit log", 150, write_sweep, mutate_log, load_log, HERE))
register(InputKind("sweep spec", 100, write_sweep, mutate_spec, load_plan, HERE))
register(InputKind("sweep plan", 100, write_sweep, parquet_mutator(lambda f, _: f / "plan.parquet"), load_plan, HERE))
register(InputKind("frontier", 80, write_frontier, parquet_mutator(lambda f, _: f / FRONTIER), load_frontier, HERE))
