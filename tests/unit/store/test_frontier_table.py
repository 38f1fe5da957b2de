"""The frontier's table: every column of the contract, and no row that contradicts itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from frontier_by_hand import frontier_row, realistic_rows

from shift3d.errors import InputError
from shift3d.store.frontier_table import FRONTIER_SCHEMA, frontier_table, machine_of, read_frontier
from shift3d.store.tables import write_table

# Design section 5.
CONTRACT = {
    *("setting", "preset", "scenes", "ms_median", "ratio_to_paper", "evaluations_per_beam", "missed_hits"),
    *("wrong_surface", "depth_p50_m", "depth_p99_m", "depth_max_m", "gradient_cosine", "score_delta", "auc_delta"),
    "pareto",
}
MAY_BE_NULL = {
    *("knob", "knob_name", "preset", "gradient_cosine", "gradient_norm_ratio", "score_delta", "auc_delta"),
    *("start", "grid", "gradient", "ratio_to_paper_chord", "attack_score"),
    *("ratio_to_paper", "detector_ms_median", "step_ms_median", "step_ratio_to_paper"),
}
MACHINE = {"processor": "some", "cores": 2, "torch": "2.13.0", "threads": 1}


def test_the_columns_are_those_of_the_contract() -> None:
    assert set(FRONTIER_SCHEMA.names) >= CONTRACT
    assert {field.name for field in FRONTIER_SCHEMA if field.nullable} == MAY_BE_NULL
    assert FRONTIER_SCHEMA.names == list(frontier_row("standard", 1.0))


def test_rows_come_back_as_they_were_with_the_machine(tmp_path: Path) -> None:
    rows = [*realistic_rows(), *realistic_rows("kitti")]
    rows[0] |= {"ms_median": np.float64(rows[0]["ms_median"]), "hits": np.int64(12), "pareto": np.bool_(False)}
    path = tmp_path / "frontier.parquet"
    write_table(path, frontier_table(rows, MACHINE))
    table = read_frontier(path)
    assert table.to_pylist() == rows and rows[0]["hits"] == 12
    assert machine_of(table) == MACHINE
    metadata = pq.read_schema(path).metadata
    assert (metadata[b"shift3d.schema"], metadata[b"shift3d.schema_version"]) == (b"frontier", b"2")
    assert json.loads(metadata[b"shift3d.machine"]) == MACHINE


def test_bytes_depend_on_content_alone_and_every_reader_takes_them(tmp_path: Path) -> None:
    rows = [frontier_row("draft", 1.5, preset="draft"), frontier_row("march 0.1 m", 2.0, knob=0.1, knob_name="step_m")]
    write_table(tmp_path / "a.parquet", frontier_table(rows, MACHINE))
    shuffled = [dict(reversed(row.items())) for row in rows]
    write_table(tmp_path / "b.parquet", frontier_table(shuffled, dict(reversed(MACHINE.items()))))
    path = tmp_path / "a.parquet"
    assert path.read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert pd.read_parquet(path)["knob"].isna().tolist() == [True, False]
    assert pl.read_parquet(path)["preset"].to_list() == ["draft", None]
    assert duckdb.sql(f"select ms_median from '{path}'").fetchall() == [(1.5,), (2.0,)]


def test_columns_that_may_be_null_may_be_left_out() -> None:
    row = {name: value for name, value in frontier_row("standard", 1.0).items() if name not in MAY_BE_NULL}
    (back,) = frontier_table([row]).to_pylist()
    assert all(back[name] is None for name in MAY_BE_NULL)
    assert machine_of(frontier_table([row])) == {}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "red"}, "has no column \\['colour'\\]"),
        ({"hits": None}, "hits is missing in row 1"),
        ({"depth_p99_m": float("nan")}, "depth_p99_m is nan"),
        ({"depth_max_m": np.float64("inf")}, "depth_max_m is inf"),
        ({"auc_delta": float("nan")}, "auc_delta is nan"),
        ({"pareto": 1}, "frontier.pareto: "),
        ({"ms_median": "fast"}, "frontier.ms_median: "),
    ],
)
def test_a_row_that_cannot_be_is_refused_by_its_column(change: dict[str, Any], message: str) -> None:
    rows = [frontier_row("march", 800.0, preset="paper"), {**frontier_row("standard", 2.0), **change}]
    with pytest.raises(ValueError, match=message):
        frontier_table(rows)


def test_the_same_setting_on_other_scenes_is_another_row_and_false_hits_have_no_bound() -> None:
    rows = [frontier_row("draft", 1.0, preset="draft", false_hits=1.5, scenes=name) for name in ("street", "kitti")]
    assert frontier_table(rows).num_rows == 2


def test_what_is_no_frontier_is_named(tmp_path: Path) -> None:
    path = tmp_path / "frontier.parquet"
    with pytest.raises(InputError, match=r"no measured frontier.*shift3d frontier"):
        read_frontier(path)
    table = frontier_table([frontier_row("standard", 1.0)])
    write_table(path, table)
    whole = path.read_bytes()
    path.write_bytes(whole[:200])
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_frontier(path)
    pq.write_table(table.replace_schema_metadata({"shift3d.schema": "scores"}), path)
    with pytest.raises(InputError, match="found scores, version none"):
        read_frontier(path)
    pq.write_table(table.replace_schema_metadata({**table.schema.metadata, b"shift3d.schema_version": b"3"}), path)
    with pytest.raises(InputError, match="version 3"):
        read_frontier(path)
    pq.write_table(table.drop_columns(["depth_p99_m"]), path)
    with pytest.raises(InputError, match=r"no column depth_p99_m.*run shift3d frontier again"):
        read_frontier(path)


@pytest.mark.parametrize("text", ["{", "[1]"])
def test_metadata_that_is_no_machine_is_named(text: str) -> None:
    table = frontier_table([frontier_row("standard", 1.0)])
    with pytest.raises(InputError, match=r"shift3d\.machine"):
        machine_of(table.replace_schema_metadata({"shift3d.machine": text}))
    assert machine_of(pa.table({"a": [1]})) == {}


def test_a_frontier_of_version_1_is_read_with_nulls_for_what_it_lacks(tmp_path: Path) -> None:
    lacking = ["start", "grid", "gradient", "ratio_to_paper_chord", "attack_score"]
    older = frontier_table(realistic_rows()).drop_columns(lacking)
    metadata = {**older.schema.metadata, b"shift3d.schema_version": b"1"}
    pq.write_table(older.replace_schema_metadata(metadata), tmp_path / "frontier.parquet")
    found = read_frontier(tmp_path / "frontier.parquet").to_pylist()
    assert all(row[name] is None for row in found for name in lacking)
    assert [row["setting"] for row in found] == [row["setting"] for row in realistic_rows()]
