"""Hard cases of a sweep's folder whose files can be read but were changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from catalogue import hard_case
from clear_errors import place, refused
from valid_sweeps import DRIVER, plan, rows, write_frontier, write_sweep

from shift3d.errors import InputError
from shift3d.store.frontier_table import read_frontier
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import read_table, table_from_rows, write_table
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final

AREA = "sweep"
SECOND, SCORES = "_log/00000002.json", f"data/00000001-{DRIVER}-scores.parquet"


def final_after(change: Callable[[Path], object]) -> None:
    with place() as folder:
        write_sweep(folder)
        change(folder)
        write_final(folder, plan(), read_log(folder))


def parquet_with(name: str, column: str, value: object) -> Callable[[Path], None]:
    """Return a change that replaces the first value of a column of the scores, whatever the schema says."""

    def change(folder: Path) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pq.read_table(folder / name, partitioning=None)
        at, field = table.schema.get_field_index(column), table.schema.field(column)
        values = [value, *table[column].to_pylist()[1:]]
        pq.write_table(table.set_column(at, field, pa.array(values, type=field.type)), folder / name)

    return change


@hard_case(
    area=AREA,
    why="in compressed numbers one flipped bit is read as another score",
    must="an error that names the segment, or the same scores",
    guard="pages carry checksums, and they are compared",
)
def a_flipped_bit_in_a_score() -> None:
    with place() as folder:
        write_sweep(folder)
        path = folder / SCORES
        whole = path.read_bytes()
        before = read_table(path, "scores")
        for at in range(4, len(whole) // 4, 70):
            path.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
            try:
                table = read_table(path, "scores")
            except InputError as error:
                assert SCORES in str(error)
            else:  # the flipped bit is in a part that is not read: a page's statistics
                assert table.equals(before), f"byte {at} is read as another value"


@hard_case(
    area=AREA,
    why="NaN in one committed score would be NaN in the AUC of its group, and shown as a gap",
    must="an error that names the segment and the column",
    guard="floating-point columns are looked through where they are read",
)
def a_committed_score_of_nan() -> None:
    refused(lambda: final_after(parquet_with(SCORES, "score", float("nan"))), SCORES, "score", "NaN")


@hard_case(
    area=AREA,
    why="a column that is gone or renamed is not missed before a mean is taken over it",
    must="an error that names the file",
    guard="the columns are compared with the schema's",
)
def a_segment_with_a_column_missing() -> None:
    def drop(folder: Path) -> None:
        import pyarrow.parquet as pq

        pq.write_table(pq.read_table(folder / SCORES, partitioning=None).drop_columns(["stable"]), folder / SCORES)

    refused(lambda: final_after(drop), SCORES, "column stable")


@hard_case(
    area=AREA,
    why="rows of tasks that the plan does not have would stand at the end of the tables, and count",
    must="an error that says how many",
    guard="every row's task must be in the plan",
)
def a_segment_of_foreign_tasks() -> None:
    def swap(folder: Path) -> None:
        foreign = [{**row, "task_id": "0" * 32} for row in rows("scores", plan().tasks[0])]
        write_table(folder / SCORES, table_from_rows("scores", foreign))

    refused(lambda: final_after(swap), "data, scores: 3 rows", "plan")


@hard_case(
    area=AREA,
    why="an entry may name any file, also one outside of the folder",
    must="an error that names the entry; as for rows of less than none and segments that do not exist",
    guard="an entry's values must be such as a driver writes",
)
def a_log_entry_that_no_driver_wrote() -> None:
    for values in (
        {"segments": {"scores": "../plan.parquet"}, "rows": {"scores": 2}},
        {"segments": {"scores": 3}, "rows": {"scores": 2}},
        {"segments": {"scores": "a.parquet"}, "rows": {"scores": -2}},
        {"segments": {"secrets": "a.parquet"}, "rows": {"secrets": 2}},
        {"done": ["abc"]},
        {"kind": "wish"},
    ):

        def spoil(folder: Path, values: dict[str, object] = values) -> None:
            path = folder / SECOND
            path.write_text(json.dumps({**json.loads(path.read_text()), **values}))

        refused(lambda spoil=spoil: final_after(spoil), SECOND)


@hard_case(
    area=AREA,
    why="a log copied from another sweep's folder says that all is done",
    must="an error that names the entry",
    guard="every entry's spec is compared with the sweep's",
)
def a_log_of_another_sweep() -> None:
    with place() as folder:
        write_sweep(folder)
        refused(lambda: CommitLog(folder, "0" * 16), "_log", "another sweep")


@hard_case(
    area=AREA,
    why="a spec or a plan that was edited by hand describes other tasks than those that were run",
    must="an error that names the folder",
    guard="the hash of all tasks is worked out again and compared",
)
def a_plan_that_was_edited() -> None:
    with place() as folder:
        write_sweep(folder)
        path = folder / "spec.yaml"
        path.write_text(path.read_text().replace(plan().spec_hash, "0" * 16))
        refused(lambda: read_plan(folder), folder.name, "one sweep")


@hard_case(
    area=AREA,
    why="a frontier's column of NaN has neither a least nor a largest value to plot",
    must="an error that names the file and the column",
    guard="a frontier that is read is looked through as segments are",
)
def a_measured_frontier_with_nan() -> None:
    with place() as folder:
        write_frontier(folder)
        parquet_with("frontier.parquet", "ms_median", float("nan"))(folder)
        refused(lambda: read_frontier(folder / "frontier.parquet"), "frontier.parquet", "ms_median")
