"""Commits to a real bucket that is silent for a while: the same commit is tried again, and counts once."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from bucket_server import new_bucket
from faulty_proxy import FaultyProxy, faulty_proxy

from shift3d.errors import InputError
from shift3d.store.buckets import object_store
from shift3d.store.location import Location
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import as_location
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.sweep.results import commit
from shift3d.sweep.results.commit import Committer

SILENT, FORBIDDEN = (503, "SlowDown"), (403, "AccessDenied")


@pytest.fixture
def proxy(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyProxy]:
    with faulty_proxy(endpoint) as found:
        monkeypatch.setenv("AWS_ENDPOINT_URL", found.address)
        monkeypatch.setitem(object_store._RETRY, "max_retries", 0)
        monkeypatch.setattr(commit, "_RETRY_S", 0.05)
        yield found


@pytest.fixture
def folder(endpoint: str, proxy: FaultyProxy) -> Location:
    return as_location(f"s3://{new_bucket(endpoint)}/sweep")


@pytest.fixture
def committer(folder: Location) -> Committer:
    return Committer(CommitLog(folder, "spec"), every_s=0.0)


def outcome(task: str) -> BatchOutcome:
    timing = {"task_id": task, "method": "baseline", "stage": "total", "milliseconds": 1.0, "calls": 1}
    return BatchOutcome(done=[task], tables={"timings": table_from_rows("timings", [timing])})


def test_results_that_come_meanwhile_are_committed_after_it(
    proxy: FaultyProxy, folder: Location, committer: Committer, capsys: pytest.CaptureFixture[str]
) -> None:
    proxy.refusal = SILENT
    for task in ("a", "b", "c"):
        committer.add(outcome(task))
        time.sleep(0.1)
    proxy.refusal = None
    committer.flush()
    assert [entry.done for entry in read_log(folder)] == [(), ("a",), ("b", "c")]
    assert [entry.rows["timings"] for entry in read_log(folder)[1:]] == [1, 2]
    assert len((folder / "data").names()) == 2
    errors = capsys.readouterr().err
    assert errors.count("the store does not answer") == 1 == errors.count("answers again")


@pytest.mark.parametrize(("patience_s", "given_up"), [(0.3, False), (900.0, True)], ids=["too long", "given up"])
def test_a_bucket_that_stays_silent_ends_the_driver(
    proxy: FaultyProxy,
    folder: Location,
    committer: Committer,
    monkeypatch: pytest.MonkeyPatch,
    patience_s: float,
    given_up: bool,
) -> None:
    monkeypatch.setattr(commit, "_PATIENCE_S", patience_s)
    proxy.refusal = SILENT
    committer.add(outcome("a"))
    with pytest.raises(InputError, match="does not answer"):
        committer.flush(lambda: given_up)
    proxy.refusal = None
    assert CommitLog(folder, "spec").done() == set()


def test_another_error_is_raised_at_once(proxy: FaultyProxy, committer: Committer) -> None:
    proxy.refusal = FORBIDDEN
    with pytest.raises(InputError, match="may not do this"):
        committer.add(outcome("a"))
