"""Buckets that refuse, forget, or do not exist: one clear line, and no log entry lost or written twice."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from bucket_server import new_bucket
from faulty_proxy import FaultyProxy, faulty_proxy
from obstore.exceptions import PermissionDeniedError

from shift3d.errors import InputError
from shift3d.store.atomic import UncertainError
from shift3d.store.buckets import object_store
from shift3d.store.location import Location
from shift3d.store.log import CommitLog, TakenOverError
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import as_location
from shift3d.store.tables import read_table, table_from_rows, write_table

TIMING = {"task_id": "a", "method": "baseline", "stage": "total", "milliseconds": 1.0, "calls": 1}


@pytest.fixture
def bucket(endpoint: str) -> Location:
    return as_location(f"s3://{new_bucket(endpoint)}")


@pytest.fixture
def proxy(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyProxy]:
    with faulty_proxy(endpoint) as found:
        monkeypatch.setenv("AWS_ENDPOINT_URL", found.address)
        monkeypatch.setitem(object_store._RETRY, "max_retries", 1)
        yield found


def refused(location: Location) -> InputError:
    """Return the error of every kind of access to it, the same for all."""
    errors = []
    for touch in (location.names, location.read_bytes, lambda: location.put_if_absent(b"x")):
        with pytest.raises(InputError) as failure:
            touch()
        errors.append(failure.value)
    assert len({error.what for error in errors}) == 1
    assert str(location) in errors[0].where and errors[0].remedy
    return errors[0]


def test_urls(endpoint: str) -> None:
    location = as_location("s3://bucket//a/b/")
    assert str(location) == "s3://bucket/a/b" and location / "c" == as_location("s3://bucket/a/b/c")
    assert (as_location("s3://bucket") / "c").name == "c"
    assert location.absolute() == location
    for wrong in ("s3://", "s3:///a", "s3://bucket/../other", "ftp://bucket/a", "s3a://bucket", "s3://b/\n"):
        with pytest.raises(InputError) as failure:
            as_location(wrong)
        assert failure.value.remedy


def test_google_urls_and_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    location = as_location("gs://bucket/a")
    assert str(location / "b") == "gs://bucket/a/b"
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT", "/no/such/key.json")
    with pytest.raises(InputError, match="GOOGLE_SERVICE_ACCOUNT"):
        as_location("gs://bucket/a")


def test_google_speaks_its_protocol(
    endpoint: str, proxy: FaultyProxy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = {"gcs_base_url": proxy.address, "disable_oauth": True, "client_email": "", "private_key": ""}
    (tmp_path / "key.json").write_text(json.dumps({**key, "private_key_id": ""}))
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT", str(tmp_path / "key.json"))
    monkeypatch.setenv("GOOGLE_ALLOW_HTTP", "true")
    folder = as_location(f"gs://{new_bucket(endpoint)}/sweep")
    log = CommitLog(folder, "spec")
    log.commit(("a",), (), {"timings": table_from_rows("timings", [TIMING])})
    assert folder.names() == ["_log", "data"]
    assert CommitLog(folder, "spec").done() == {"a"}
    with pytest.raises(TakenOverError):
        log.commit(("b",), (), {})
    proxy.unconditional = True
    with pytest.raises(InputError, match="two drivers would not notice"):
        folder.check_writable()


def test_a_bucket_that_does_not_exist(endpoint: str) -> None:
    assert "no such bucket" in refused(as_location("s3://nobody-made-this/a")).what


@pytest.mark.parametrize(
    ("refusal", "what"),
    [
        ((403, "InvalidAccessKeyId"), "credentials are refused"),
        ((403, "SignatureDoesNotMatch"), "credentials are refused"),
        ((403, "AccessDenied"), "may not do this"),
        ((503, "SlowDown"), "does not answer"),
        ((501, "NotImplemented"), "only if it is absent"),
    ],
)
def test_a_store_that_refuses(proxy: FaultyProxy, bucket: Location, refusal: tuple[int, str], what: str) -> None:
    proxy.refusal = refusal
    with pytest.raises(UncertainError, match=what) as failure:
        (bucket / "entry").put_if_absent(b"x")
    assert str(bucket) in failure.value.where and failure.value.remedy
    assert len(proxy.requests) <= 6, "bounded"


def test_a_store_that_cannot_be_reached(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setenv("AWS_ENDPOINT_URL", address)
    monkeypatch.setitem(object_store._RETRY, "max_retries", 1)
    error = refused(as_location("s3://bucket-that-is-away/a"))
    assert "cannot be reached" in error.what and address in error.what and "AWS_ENDPOINT_URL" in error.remedy
    monkeypatch.setenv("AWS_ALLOW_HTTP", "false")
    assert "AWS_ALLOW_HTTP" in refused(as_location("s3://bucket-that-is-away/a")).remedy


def test_a_store_without_conditions_is_refused_before_anything_is_run(proxy: FaultyProxy, bucket: Location) -> None:
    proxy.unconditional = True
    with pytest.raises(InputError, match="two drivers would not notice"):
        CommitLog(bucket / "sweep", "spec")
    assert read_log(bucket / "sweep") == [] and bucket.names() == []


def test_a_probe_that_cannot_be_removed_hides(bucket: Location, monkeypatch: pytest.MonkeyPatch) -> None:
    """The credentials may not delete, or another driver tries the same folder."""

    def denied(*_: object, **__: object) -> None:
        raise PermissionDeniedError("AccessDenied")

    monkeypatch.setattr(object_store.obstore, "delete", denied)
    (bucket / "new").check_writable()
    assert (bucket / "new").names() == []


def test_no_conditional_put_by_its_settings(bucket: Location, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_CONDITIONAL_PUT", "disabled")
    with pytest.raises(InputError, match="only if it is absent"):
        CommitLog(bucket / "sweep", "spec")


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_a_commit_whose_answer_is_lost_is_known_as_ones_own(proxy: FaultyProxy, bucket: Location, lost: int) -> None:
    log = CommitLog(bucket / "sweep", "spec")
    log.commit((), (), {})
    proxy.lost = lost
    log.commit(("a",), (), {})
    assert proxy.lost == max(0, lost - 2), "the answers were lost"
    proxy.lost = 0
    assert [entry.done for entry in read_log(bucket / "sweep")] == [(), (), ("a",)]
    log.commit(("b",), (), {})
    newer = CommitLog(bucket / "sweep", "spec")
    assert newer.done() == {"a", "b"}
    with pytest.raises(TakenOverError):
        log.commit(("c",), (), {})


@pytest.mark.parametrize("arrives", [False, True], ids=["refused", "answer lost, then unreadable"])
def test_segments_of_an_entry_that_may_be_there_are_kept(proxy: FaultyProxy, bucket: Location, arrives: bool) -> None:
    log = CommitLog(bucket / "sweep", "spec")
    tables = {"timings": table_from_rows("timings", [TIMING])}
    whole = log._append

    def while_the_store_is_away(*arguments: object) -> object:
        proxy.refusal, proxy.refused, proxy.lost = (503, "SlowDown"), ("GET",) if arrives else (), int(arrives)
        return whole(*arguments)  # type: ignore[arg-type]

    log._append = while_the_store_is_away  # type: ignore[method-assign,assignment]
    with pytest.raises(UncertainError):
        log.commit(("a",), (), tables)
    proxy.refusal = None
    assert len((bucket / "sweep" / "data").names()) == 1
    assert [entry.done for entry in read_log(bucket / "sweep")[1:]] == [("a",)] * arrives
    log._append = whole  # type: ignore[method-assign]
    log.check_own()
    log.commit(("a",), (), tables)
    assert [entry.done for entry in read_log(bucket / "sweep")] == [(), ("a",)], "the same commit counts once"
    assert len((bucket / "sweep" / "data").names()) == 1


def test_large_tables_and_their_bytes(bucket: Location, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_store, "_IN_ONE_PIECE", 1000)
    rows = [{**TIMING, "task_id": str(number), "milliseconds": float(number)} for number in range(2000)]
    table = table_from_rows("timings", rows)
    write_table(bucket / "timings.parquet", table)
    assert (bucket / "timings.parquet").size() > 1000
    assert read_table(bucket / "timings.parquet", "timings").equals(table)
    with pytest.raises(InputError, match="is missing") as failure:
        read_table(bucket / "absent.parquet", "timings")
    assert failure.value.where == f"{bucket}/absent.parquet"


@pytest.mark.parametrize(
    "address", ["minio:9000", "localhost", "https://", "http://127.0.0.1:port", "http://h:65536", "", "http://a b"]
)
def test_an_endpoint_that_is_no_address_is_one_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", address)
    with pytest.raises(InputError, match=r"AWS_ENDPOINT_URL: .* no address of a store\. Give AWS_ENDPOINT_URL"):
        as_location("s3://bucket/runs")
