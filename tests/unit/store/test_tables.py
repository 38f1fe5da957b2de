"""Rows to tables: strict about columns, exact about bytes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest

from shift3d.errors import InputError
from shift3d.store.migrations import current_table
from shift3d.store.schemas import SCHEMA_VERSION, SCHEMAS
from shift3d.store.tables import parquet_bytes, read_parquet, read_table, table_from_rows, write_table

# Design section 5.
CONTRACT = [
    *("task_id", "sweep", "vehicle", "scene", "dataset", "mode", "lambda", "alpha", "detector", "scored_by"),
    *("method", "replicate", "score", "adversarial_loss", "latent_distance"),
    *("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad", "range_m", "object_points"),
    *("overlap_ok", "contact_ok", "best_step", "accuracy", "search", "effects", "score_reference", "stable", "status"),
    *("max_residual_m", "unresolved_beams"),
]


def score_row(**changes: Any) -> dict[str, Any]:
    texts = ("task_id", "sweep", "vehicle", "scene", "dataset", "mode", "detector", "scored_by", "method")
    row: dict[str, Any] = dict.fromkeys((*texts, "accuracy", "search", "status"), "x")
    return {**row, "alpha": 0.01, "replicate": 0, "effects": ["rain"], **changes}


@pytest.mark.parametrize("folder", ["run:1", "s3:", "file:", "2026-01-01T10:00"])
def test_a_folder_may_have_a_colon_in_its_name(folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    table = table_from_rows("scores", [score_row()])
    write_table(Path(folder) / "scores.parquet", table)
    assert read_table(Path(folder) / "scores.parquet", "scores").equals(table)


def test_scores_begin_with_the_columns_of_the_contract_in_its_order() -> None:
    assert SCHEMAS["scores"].names[: len(CONTRACT)] == CONTRACT, "the project's own columns follow at the end"
    assert SCHEMAS["timings"].names == ["task_id", "method", "stage", "milliseconds", "calls"]


def test_every_change_of_a_table_s_columns_has_a_version_and_a_migration() -> None:
    """Tables that older programs wrote have the current columns once they are migrated."""
    files = sorted((Path(__file__).parents[2] / "reference").glob("schema_*/data/*.parquet"))
    assert files
    for file in files:
        table, name, version = read_parquet(file, "")
        differ = {*current_table(name, table, version, str(file)).column_names} ^ {*SCHEMAS[name].names}
        remedy = "raise `version` in store/tables.toml; name them in store/migrations.py: _ADDED or _DROPPED"
        assert not differ, f"{name} of version {version}, columns {sorted(differ)}: {remedy}"


def test_numpy_values_and_missing_ones(tmp_path: Path) -> None:
    rows = [score_row(score=np.float32(0.5), best_step=np.int64(3), stable=np.bool_(True)), score_row()]
    write_table(tmp_path / "scores.parquet", table_from_rows("scores", rows))
    back = read_table(tmp_path / "scores.parquet", "scores").to_pylist()
    assert (back[0]["score"], back[0]["best_step"], back[0]["stable"]) == (0.5, 3, True)
    assert (back[1]["score"], back[1]["lambda"], back[1]["effects"]) == (None, None, ["rain"])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (score_row(colour="red"), "has no column"),
        ({**score_row(), "method": None}, r"scores\.method is missing"),
        (score_row(score="high"), r"scores\.score"),
        (score_row(score=float("nan")), r"scores\.score is nan"),
        (score_row(adversarial_loss=float("inf")), r"scores\.adversarial_loss is inf"),
        (score_row(best_step=2**40), r"scores\.best_step"),
    ],
)
def test_a_row_that_does_not_fit_is_refused_by_column(row: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        table_from_rows("scores", [score_row(), row])


def test_bytes_depend_on_content_alone(tmp_path: Path) -> None:
    rows = [score_row(task_id=str(i), score=i / 100) for i in range(100)]
    write_table(tmp_path / "whole", table_from_rows("scores", rows))
    parts = [table_from_rows("scores", rows[i : i + 7]) for i in range(0, 100, 7)]
    import pyarrow as pa

    write_table(tmp_path / "parts", pa.concat_tables(parts))
    assert (tmp_path / "whole").read_bytes() == (tmp_path / "parts").read_bytes()


def test_pandas_polars_and_duckdb_read_it_and_the_version_is_there(tmp_path: Path) -> None:
    path = tmp_path / "scores.parquet"
    write_table(path, table_from_rows("scores", [score_row(score=0.25)]))
    assert pd.read_parquet(path)["score"].tolist() == [0.25]
    assert pl.read_parquet(path)["score"].to_list() == [0.25]
    assert duckdb.sql(f"select score from '{path}'").fetchall() == [(0.25,)]
    metadata = pq.read_schema(path).metadata
    assert metadata[b"shift3d.schema_version"] == str(SCHEMA_VERSION).encode()
    assert metadata[b"shift3d.schema"] == b"scores"


def test_read_bytes_are_free_at_once(tmp_path: Path) -> None:
    """A thread that holds them waits for the interpreter's lock, and the program aborts if it ends in the meantime."""
    content = parquet_bytes(table_from_rows("scores", [score_row()] * 3))
    owners = sys.getrefcount(content)
    for _ in range(50):
        assert read_parquet(tmp_path, "", content)[0].num_rows == 3
        assert sys.getrefcount(content) == owners


def test_another_table_and_a_torn_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "scores.parquet"
    write_table(path, table_from_rows("scores", [score_row()]))
    with pytest.raises(InputError, match="is not a timings table"):
        read_table(path, "timings")
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_table(path, "scores")
    with pytest.raises(InputError, match="is missing"):
        read_table(tmp_path / "absent", "scores")
