"""The commit log: one writer, and a segment counts only through its entry."""

from __future__ import annotations

from pathlib import Path

import pytest

from shift3d.errors import InputError
from shift3d.store.log import CommitLog, TakenOverError
from shift3d.store.log_entries import read_log
from shift3d.store.tables import read_table, table_from_rows

TIMING = {"task_id": "a", "method": "baseline", "stage": "total", "milliseconds": 1.0, "calls": 1}


def test_what_is_committed_is_read_back(tmp_path: Path) -> None:
    log = CommitLog(tmp_path, "spec")
    log.commit(("a",), ("b",), {"timings": table_from_rows("timings", [TIMING])})
    log.commit(("b",), (), {})
    entries = read_log(tmp_path)
    assert [entry.kind for entry in entries] == ["session", "commit", "commit"]
    assert [entry.sequence for entry in entries] == [0, 1, 2]
    assert entries == log.entries
    name = entries[1].segments["timings"]
    assert read_table(tmp_path / "data" / name, "timings").to_pylist() == [TIMING]
    again = CommitLog(tmp_path, "spec")
    assert again.done() == {"a", "b"}
    assert again.quarantined() == set(), "a task that succeeds later is not quarantined"


def test_the_older_of_two_drivers_is_stopped_and_its_rows_do_not_count(tmp_path: Path) -> None:
    old = CommitLog(tmp_path, "spec")
    new = CommitLog(tmp_path, "spec")
    with pytest.raises(TakenOverError, match="another driver took this sweep over"):
        old.commit(("a",), (), {"timings": table_from_rows("timings", [TIMING])})
    assert list((tmp_path / "data").iterdir()) == []
    new.commit(("a",), (), {"timings": table_from_rows("timings", [TIMING])})
    assert [entry.driver for entry in read_log(tmp_path)] == [old.driver, new.driver, new.driver]


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is not a commit log entry"), (b'{"schema_version": 99}', "has schema version 99")],
)
def test_damaged_entries_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    CommitLog(tmp_path, "spec")
    (tmp_path / "_log" / "00000000.json").write_bytes(content)
    with pytest.raises(InputError, match=message) as failure:
        read_log(tmp_path)
    assert "00000000.json" in failure.value.where and failure.value.remedy


def test_a_hole_in_the_log_is_an_error(tmp_path: Path) -> None:
    log = CommitLog(tmp_path, "spec")
    log.commit(("a",), (), {})
    (tmp_path / "_log" / "00000000.json").unlink()
    with pytest.raises(InputError, match=r"00000000\.json is missing"):
        CommitLog(tmp_path, "spec")


def test_a_driver_takes_over_although_the_other_one_commits_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other driver commits three times between this driver's reading of the log and its first entry."""
    old, left, whole = CommitLog(tmp_path, "spec"), ["a", "b", "c"], CommitLog._append

    def slow(self: CommitLog, kind: str, *arguments: object) -> object:
        if kind == "session" and left:
            whole(old, "commit", (left.pop(),), (), {})
        return whole(self, kind, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(CommitLog, "_append", slow)
    new = CommitLog(tmp_path, "spec")
    assert new.done() == {"a", "b", "c"} and new.entries == read_log(tmp_path)
    with pytest.raises(TakenOverError):
        old.commit(("d",), (), {})
