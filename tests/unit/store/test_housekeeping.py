"""gc and compact: no valid data is lost, whoever runs and whenever a process is killed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bucket_server import new_bucket

from shift3d.errors import InputError
from shift3d.store.buckets.object_store import ObjectLocation
from shift3d.store.housekeeping import collect, compact, find_garbage
from shift3d.store.location import LocalLocation, Location
from shift3d.store.log import CommitLog, TakenOverError, committed_rows
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import as_location
from shift3d.store.tables import table_from_rows, write_table

TASKS = ("a", "b", "c", "d")


@pytest.fixture(params=["folder", "bucket"])
def sweep(request: pytest.FixtureRequest, tmp_path: Path) -> Location:
    """Work of two drivers: the first committed a, b; the second c, d; d was first quarantined, e still is."""
    where = tmp_path / "sweep"
    if request.param == "bucket":
        where = f"s3://{new_bucket(request.getfixturevalue('endpoint'))}/sweep"
    return filled(as_location(where))


def filled(folder: Location) -> Location:
    first = CommitLog(folder, "spec")
    first.commit(("a",), ("d",), tables("a", "d"))
    first.commit(("b",), (), tables("b"))
    second = CommitLog(folder, "spec")
    second.commit(("c",), ("e",), tables("c", "e"))
    second.commit(("d",), (), tables("d"))
    return folder


def tables(*tasks: str) -> dict[str, Any]:
    timings = [{"task_id": task, "method": "m", "stage": "s", "milliseconds": 1.0, "calls": 1} for task in tasks]
    attempts = [{"task_id": t, "attempt": 1, "outcome": "done", "quarantined": False, "worker": "w"} for t in tasks]
    attempts = [{**row, "started_unix_s": 0.0, "seconds": 0.0} for row in attempts]
    return {"timings": table_from_rows("timings", timings), "attempts": table_from_rows("attempts", attempts)}


def what_counts(folder: Location) -> Any:
    entries = read_log(folder)
    rows = {name: committed_rows(folder, entries, name).to_pylist() for name in ("timings", "attempts", "scores")}
    done = [task for entry in entries for task in entry.done]
    abandoned = {task for entry in entries for task in entry.quarantined} - set(done)
    return rows, done, abandoned


def test_compact_keeps_what_counts_in_its_order(sweep: Location) -> None:
    before = what_counts(sweep)
    done = compact(sweep)
    assert (done.entries, done.segments) == (6, 8) and done.entry.kind == "compact"
    assert what_counts(sweep) == before
    assert (sweep / "_log").names() == ["00000000.json", "00000003.json", "00000006.json", "00000007.json"]
    assert len((sweep / "data").names()) == 2
    log = CommitLog(sweep, "spec")
    assert log.done() == set(TASKS) and log.quarantined() == {"e"} and log.finished() == {*TASKS, "e"}
    log.commit(("e",), (), tables("e"))
    assert [entry.sequence for entry in read_log(sweep)] == [7, 8, 9]
    after = what_counts(sweep)
    assert compact(sweep).removed == 6, "a commit, the former compaction's entry, and two segments of each"
    assert what_counts(sweep) == after and len(read_log(sweep)) == 1


def test_compact_stops_a_driver_that_runs_or_sleeps(sweep: Location) -> None:
    sleeping = CommitLog(sweep, "spec")
    running = CommitLog(sweep, "spec")
    running.commit(("f",), (), tables("f"))
    compact(sweep)
    before = what_counts(sweep)
    for driver in (running, sleeping):
        with pytest.raises(TakenOverError):
            driver.commit(("g",), (), tables("g"))
    assert what_counts(sweep) == before and len((sweep / "data").names()) == 2


def test_gc_removes_orphans_and_nothing_of_a_driver_that_may_run(sweep: Location) -> None:
    before, data = what_counts(sweep), sweep / "data"
    killed, running = CommitLog(sweep, "spec"), CommitLog(sweep, "spec")
    write_table(data / f"00000006-{killed.driver}-timings.parquet", tables("f")["timings"])
    write_table(data / f"00000008-{running.driver}-timings.parquet", tables("f")["timings"])
    (data / "notes.txt").write_atomic(b"mine")
    (data / "00000009-1-0a0a0a0a-timings.parquet").write_atomic(b"of a driver that the log does not know")
    garbage = find_garbage(sweep)
    assert [file.name for file in garbage.files] == [f"00000006-{killed.driver}-timings.parquet"]
    assert garbage.unknown == ("00000009-1-0a0a0a0a-timings.parquet", "notes.txt")
    collect(garbage)
    collect(garbage)
    assert find_garbage(sweep).files == () and what_counts(sweep) == before
    running.commit(("f",), (), tables("f"))
    assert find_garbage(sweep).files == ()


def test_gc_removes_temporary_files_of_the_dead(tmp_path: Path) -> None:
    folder = filled(as_location(tmp_path / "sweep"))
    for part in (".", "_log", "data"):
        (tmp_path / "sweep" / part / ".tmp-4194400-x").touch()
    collect(find_garbage(folder))
    assert not list(tmp_path.rglob(".tmp-*"))


def test_a_damaged_log_makes_nothing_garbage(sweep: Location) -> None:
    (sweep / "_log" / "00000002.json").write_atomic(b"{")
    files = (sweep / "data").names()
    for command in (find_garbage, compact):
        with pytest.raises(InputError, match="is not a commit log entry"):
            command(sweep)
    assert (sweep / "data").names() == files
    with pytest.raises(InputError, match="has no commit log"):
        compact(sweep / "nowhere")


class Killed(BaseException):
    """Simulated end of a process."""


def killed_at(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    """End the process before its step-th write or removal: nothing happens after it, no clean-up either."""
    left = [step]

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise Killed
            return function(*arguments)

        return call

    for kind in (LocalLocation, ObjectLocation):
        for name in ("write_atomic", "put_if_absent", "delete"):
            monkeypatch.setattr(kind, name, counted(getattr(kind, name)))


def test_compact_killed_before_any_of_its_steps_leaves_a_sweep_that_reads_the_same(sweep: Location) -> None:
    before = what_counts(sweep)
    for step in range(200):
        with pytest.MonkeyPatch.context() as monkeypatch:
            killed_at(monkeypatch, step)
            try:
                compact(sweep)
                break
            except Killed:
                pass
        assert what_counts(sweep) == before
        if step % 4 == 3:
            assert CommitLog(sweep, "spec").finished() == {*TASKS, "e"}
            assert what_counts(sweep) == before
    assert step > 8, "it was killed"
    CommitLog(sweep, "spec")
    collect(find_garbage(sweep))
    kinds = [entry.kind for entry in read_log(sweep)]
    assert kinds[0] == "compact" and set(kinds[1:]) <= {"session"}
    assert len((sweep / "data").names()) == 2 and what_counts(sweep) == before


_CHILD = """
import os, sys
from shift3d.store import location
from shift3d.store.housekeeping import compact
left = [int(sys.argv[2])]
for name in ("write_atomic", "put_if_absent", "delete"):
    def call(*arguments, function=getattr(location.LocalLocation, name)):
        left[0] -= 1
        if left[0] < 0:
            os._exit(9)
        return function(*arguments)
    setattr(location.LocalLocation, name, call)
compact(sys.argv[1])
"""


@pytest.mark.parametrize("step", [3, 5])
def test_a_process_that_ends_during_compact(tmp_path: Path, step: int) -> None:
    folder = filled(as_location(tmp_path / "sweep"))
    before = what_counts(folder)
    child = subprocess.run([sys.executable, "-c", _CHILD, str(folder), str(step)], check=False)
    assert child.returncode == 9 and what_counts(folder) == before
    compact(folder)
    assert what_counts(folder) == before and len((folder / "data").names()) == 2


def test_a_reader_whose_entries_vanish_reads_again(sweep: Location, monkeypatch: pytest.MonkeyPatch) -> None:
    """A compaction takes place between the reader's listing and its reading."""
    before, names, kind = what_counts(sweep), type(sweep).names, type(sweep)
    raced = []

    def listed(self: Location) -> list[str]:
        found = names(self)
        if self.name == "_log" and not raced:
            raced.append(self)
            compact(sweep)
        return found

    monkeypatch.setattr(kind, "names", listed)
    assert [entry.kind for entry in read_log(sweep)] == ["compact"]
    assert raced and what_counts(sweep) == before
