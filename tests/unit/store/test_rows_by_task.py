"""Reading one task's rows gives those of the whole table, and reads the task's own row groups alone."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shift3d.errors import InputError
from shift3d.store.rows_by_task import RowsByTask
from shift3d.store.tables import read_table, table_from_rows

TASKS = {f"{number:032x}": 1 + number % 4 for number in range(40)}
ROW_GROUP = 7  # no multiple of a task's rows: some tasks are in two groups


def written(path: Path, tasks: list[str]) -> Path:
    times = [{"method": "adversarial", "milliseconds": float(at), "calls": at} for at in range(len(tasks))]
    rows = [{"task_id": task, "stage": f"stage {at}", **times[at]} for at, task in enumerate(tasks)]
    pq.write_table(table_from_rows("timings", rows), path, row_group_size=ROW_GROUP, write_page_checksum=True)
    return path


@pytest.fixture
def in_plan_order(tmp_path: Path) -> Path:
    return written(tmp_path / "timings.parquet", [task for task, rows in TASKS.items() for _ in range(rows)])


def expected(path: Path, task: str) -> list[dict[str, object]]:
    return [row for row in read_table(path, "timings").to_pylist() if row["task_id"] == task]


def test_each_task_gets_its_rows_in_any_order_of_asking(in_plan_order: Path) -> None:
    rows = RowsByTask(in_plan_order, "timings")
    for task in [*TASKS, *list(TASKS)[::-7]]:
        found = rows.of(task)
        assert len(found) == TASKS[task]
        assert found == expected(in_plan_order, task)
    assert rows.of("f" * 32) == []


def test_rows_of_a_task_that_do_not_stand_together_are_found_too(tmp_path: Path) -> None:
    path = written(tmp_path / "timings.parquet", [task for _ in range(3) for task in TASKS])
    rows = RowsByTask(path, "timings")
    for task in TASKS:
        assert rows.of(task) == expected(path, task)


def test_a_table_without_rows_has_none(tmp_path: Path) -> None:
    assert RowsByTask(written(tmp_path / "timings.parquet", []), "timings").of(next(iter(TASKS))) == []


def test_only_the_row_groups_of_a_task_are_read(in_plan_order: Path) -> None:
    metadata = pq.read_metadata(in_plan_order)
    chunk = metadata.row_group(metadata.num_row_groups - 1).column(metadata.schema.names.index("milliseconds"))
    content = bytearray(in_plan_order.read_bytes())
    content[chunk.data_page_offset + chunk.total_compressed_size - 1] ^= 1
    in_plan_order.write_bytes(bytes(content))
    rows, (first, *_, last) = RowsByTask(in_plan_order, "timings"), TASKS
    assert len(rows.of(first)) == TASKS[first]
    with pytest.raises(InputError, match="cannot be read"):
        rows.of(last)


def test_a_file_that_is_no_table_of_its_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "timings.parquet"
    with pytest.raises(InputError, match="is missing"):
        RowsByTask(path, "timings")
    pq.write_table(pa.table({"task_id": ["a"]}), path)
    with pytest.raises(InputError, match="is not a timings table"):
        RowsByTask(path, "timings")
