"""Hard cases of a sweep's own folder: plan, commit log, segments."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

from catalogue import hard_case
from clear_errors import place, refused
from valid_sweeps import DRIVER, plan, rows, write_sweep

from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.tables import read_table, table_from_rows
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.spec_file import read_spec
from shift3d.sweep.results.final import FinalTables, write_final
from shift3d.sweep.status import read_status

AREA = "sweep"
SECOND = "_log/00000002.json"
SCORES, TIMINGS = (f"data/00000001-{DRIVER}-{name}.parquet" for name in ("scores", "timings"))


def finished(change: Callable[[Path], object]) -> FinalTables:
    """Return the final tables of a finished sweep of two tasks, after a change of its folder."""
    with place() as folder:
        write_sweep(folder)
        change(folder)
        return write_final(folder, plan(), read_log(folder))


def in_entry(**values: object) -> Callable[[Path], object]:
    """Return a change that replaces values of the second log entry."""

    def change(folder: Path) -> None:
        path = folder / SECOND
        path.write_text(json.dumps({**json.loads(path.read_text()), **values}))

    return change


@hard_case(
    area=AREA,
    why="an entry that a full disk or a copy cut off says nothing of what it finished",
    must="an error that names the entry: skipped, its tasks would be run and counted twice",
    guard="an entry that is no JSON is an error of ours",
)
def a_log_entry_that_is_torn() -> None:
    def tear(folder: Path) -> None:
        (folder / SECOND).write_bytes((folder / SECOND).read_bytes()[:-40])

    refused(lambda: finished(tear), SECOND)


@hard_case(
    area=AREA,
    why="with an entry gone the rest still reads as a log, of fewer tasks",
    must="an error that names the entry that is missing",
    guard="entries are numbered, and the numbers are counted",
)
def a_log_with_an_entry_missing() -> None:
    refused(lambda: finished(lambda folder: (folder / "_log" / "00000001.json").unlink()), "00000001.json is missing")


@hard_case(
    area=AREA,
    why="a driver that was killed leaves a temporary file in the log",
    must="it counts for nothing, and the tables are whole",
    guard="entries begin with a digit, temporary files with a dot, and neither is listed without the other",
)
def a_file_that_a_killed_driver_left() -> None:
    def leave(folder: Path) -> None:
        (folder / "_log" / ".tmp-4194305-00000003.json").write_text('{"torn')

    assert finished(leave).tables["scores"].num_rows == 6


@hard_case(
    area=AREA,
    why="the same names may mean something else in another version",
    must="an error that says which version it is",
    guard="an entry's version is compared",
)
def a_log_entry_of_another_version() -> None:
    refused(lambda: finished(in_entry(schema_version=1)), SECOND, "version 1")


@hard_case(
    area=AREA,
    why="a segment of another length than was committed is another file under the same name",
    must="an error that names it and both lengths",
    guard="rows are counted against the log",
)
def a_segment_of_another_length_than_was_committed() -> None:
    def shorten(folder: Path) -> None:
        import pyarrow.parquet as pq

        pq.write_table(pq.read_table(folder / SCORES, partitioning=None).slice(0, 2), folder / SCORES)

    refused(lambda: finished(shorten), SCORES, "2 rows, 3 were committed")


@hard_case(
    area=AREA,
    why="Parquet keeps its directory at the end: of a file that was cut off nothing is left",
    must="an error that names the segment",
    guard="errors of the Parquet reader become ours",
)
def a_segment_that_is_torn() -> None:
    def tear(folder: Path) -> None:
        (folder / SCORES).write_bytes((folder / SCORES).read_bytes()[:-100])

    refused(lambda: finished(tear), SCORES, "Parquet")


@hard_case(
    area=AREA,
    why="a table of another kind is as good a Parquet file",
    must="an error that names the file and the kind that it should be",
    guard="every table carries its kind and version",
)
def a_segment_of_another_kind() -> None:
    with place() as folder:
        write_sweep(folder)
        (folder / TIMINGS).replace(folder / SCORES)
        refused(lambda: read_table(folder / SCORES, "scores"), SCORES, "is not a scores table")


@hard_case(
    area=AREA,
    why="a spec of another version describes tasks that are run differently today",
    must="an error that says which version it is, and what to do",
    guard="the spec's version is compared",
)
def a_spec_of_another_version() -> None:
    with place() as folder:
        write_sweep(folder)
        path = folder / "spec.yaml"
        path.write_text(path.read_text().replace("schema_version: ", "schema_version: 99"))
        refused(lambda: read_spec(folder), "spec.yaml", "schema version 99")
        refused(lambda: read_plan(folder), "spec.yaml")


@hard_case(
    area=AREA,
    why="a spec that a copy cut short between two lines is YAML, and lacks what a status or a resumed sweep reads",
    must="an error that names the spec, wherever it was cut",
    guard="what every spec has is looked for when it is read",
)
def a_spec_that_was_cut_short() -> None:
    with place() as folder:
        write_sweep(folder)
        path = folder / "spec.yaml"
        lines = path.read_text().splitlines(keepends=True)
        for count in range(1, 1 + next(at for at, line in enumerate(lines) if line.startswith("settings"))):
            path.write_text("".join(lines[:count]))
            refused(lambda: read_status(folder), "spec.yaml")
            refused(lambda: read_plan(folder), "spec.yaml")


@hard_case(
    area=AREA,
    why="two sweeps in one folder would mix their results",
    must="an error that names what differs; the folder is left as it was",
    guard="the folder's spec is compared by the hash of all its tasks",
)
def a_folder_that_holds_another_sweep() -> None:
    with place() as folder:
        write_sweep(folder)
        other = dataclasses.replace(plan(), tasks=plan().tasks[:1])
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        refused(lambda: open_folder(folder, other), folder.name, "2 tasks, not 1", "out=DIR")
        assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@hard_case(
    area=AREA,
    why="two drivers that both append would finish every task twice",
    must="the one that comes second stops, and its segments are gone",
    guard="an entry is created only where there is none",
)
def a_second_driver_in_one_folder() -> None:
    with place() as folder:
        write_sweep(folder)
        first = CommitLog(folder, plan().spec_hash)
        CommitLog(folder, plan().spec_hash)
        segments = sorted((folder / "data").iterdir())
        tables = {"scores": table_from_rows("scores", rows("scores", plan().tasks[0]))}
        refused(lambda: first.commit((plan().tasks[0].spec.task_id,), (), tables), folder.name, "took this sweep over")
        assert sorted((folder / "data").iterdir()) == segments


@hard_case(
    area=AREA,
    why="NaN in one row would be NaN in the mean of all",
    must="an error that names the column, before a file is touched",
    guard="numbers are looked through where rows become a table",
)
def a_result_that_is_nan() -> None:
    for value in (math.nan, math.inf):
        row = {**rows("scores", plan().tasks[0])[0], "score": value}
        try:
            table_from_rows("scores", [row])
        except ValueError as error:  # a task's defect, not the user's input
            assert "scores.score is" in str(error)
        else:
            raise AssertionError("taken as if nothing were wrong")
