"""A bucket that is silent for a while: the same commit is tried again, and counts once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from shift3d.errors import InputError
from shift3d.store.atomic import UncertainError
from shift3d.store.buckets.object_errors import SilentStoreError
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import as_location
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.sweep.results import commit
from shift3d.sweep.results.commit import Committer

SILENCE = SilentStoreError("the store does not answer", "s3://bucket/a", "Check the network")


def outcome(task: str) -> BatchOutcome:
    timing = {"task_id": task, "method": "baseline", "stage": "total", "milliseconds": 1.0, "calls": 1}
    return BatchOutcome(done=[task], tables={"timings": table_from_rows("timings", [timing])})


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Monotonic time, which pauses advance."""
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    return now


def silent(log: CommitLog, tries: float, arrives: bool) -> None:
    """Make the next ``tries`` entries of a log end without an answer. arrives: the first one is written yet."""
    whole, count = log._append, [tries]

    def append(*arguments: Any) -> Any:
        if count[0] <= 0:
            return whole(*arguments)
        if arrives and count[0] == tries:
            whole(*arguments)
            del log.entries[-1]
        count[0] -= 1
        raise UncertainError(SILENCE.what, SILENCE.where, SILENCE.remedy) from SILENCE

    log._append = append  # type: ignore[method-assign]


@pytest.mark.parametrize("arrives", [False, True])
def test_results_that_come_meanwhile_are_committed_after_it(
    tmp_path: Path, clock: list[float], capsys: pytest.CaptureFixture[str], arrives: bool
) -> None:
    log = CommitLog(as_location(tmp_path), "spec")
    committer = Committer(log, every_s=0.0)
    silent(log, 2, arrives)
    for task in ("a", "b"):
        committer.add(outcome(task))
        log.check_own()
    assert log.done() <= {"a"}
    committer.flush()
    assert [entry.done for entry in read_log(tmp_path)] == [(), ("a",), ("b",)]
    assert all(entry.rows["timings"] == 1 for entry in read_log(tmp_path)[1:])
    assert len(list((tmp_path / "data").iterdir())) == 2
    errors = capsys.readouterr().err
    assert errors.count("s3://bucket/a: the store does not answer") == 1 and errors.count("answers again") == 1


def test_a_bucket_that_stays_silent_ends_the_driver(tmp_path: Path, clock: list[float]) -> None:
    log = CommitLog(as_location(tmp_path), "spec")
    committer = Committer(log, every_s=0.0)
    silent(log, float("inf"), False)
    committer.add(outcome("a"))
    with pytest.raises(InputError, match="does not answer"):
        committer.flush()
    assert commit._PATIENCE_S <= clock[0] <= commit._PATIENCE_S + commit._RETRY_S + 1.0
    assert CommitLog(as_location(tmp_path), "spec").done() == set()


def test_a_user_who_gives_up_does_not_wait(tmp_path: Path, clock: list[float]) -> None:
    log = CommitLog(as_location(tmp_path), "spec")
    committer = Committer(log, every_s=0.0)
    silent(log, float("inf"), False)
    committer.add(outcome("a"))
    with pytest.raises(InputError, match="does not answer"):
        committer.flush(lambda: True)
    assert clock[0] == 0.0


def test_another_error_is_raised_at_once(tmp_path: Path) -> None:
    log = CommitLog(as_location(tmp_path), "spec")
    committer = Committer(log, every_s=0.0)
    (tmp_path / "data").write_text("no folder")
    with pytest.raises(InputError, match="data"):
        committer.add(outcome("a"))
