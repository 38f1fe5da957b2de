"""Parts of the small sweeps of these tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from shift3d.store.tables import read_table, write_table

CHEAP = ("scenes.count=1", "scenes.sensor=hdl64", "scenes.traffic=family", "attack.steps=2",
         "attack.alpha=0.1", "accuracy.render.sdf_grid=false", "runner=local", "tracking=none")  # fmt: skip


def set_stable(folder: Path, stable: Mapping[str, bool | None]) -> None:
    """Write a verification with this result by vehicle."""
    path = folder / "final" / "scores.parquet"
    table = read_table(path, "scores")
    values = pa.array([stable[vehicle] for vehicle in table["vehicle"].to_pylist()], type=pa.bool_())
    column = table.schema.get_field_index("stable")
    write_table(path, table.set_column(column, table.schema.field("stable"), values))
