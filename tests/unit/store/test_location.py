"""Requirements of a sweep's folder in any location."""

from __future__ import annotations

import multiprocessing
import threading
from pathlib import Path

import boto3
import pytest
from bucket_server import new_bucket

from shift3d.errors import InputError
from shift3d.store.buckets import object_errors
from shift3d.store.buckets.object_store import STORES
from shift3d.store.location import LocalLocation, Location
from shift3d.store.resolve import as_location, local_copy


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Location:
    if request.param == "folder":
        return as_location(tmp_path / "sweep")
    return as_location(f"s3://{new_bucket(request.getfixturevalue('endpoint'))}/some/sweep")


def test_names_join_and_compare(place: Location) -> None:
    assert str(place / "final" / "a.parquet") == f"{place}/final/a.parquet"
    assert (place / "final" / "a.parquet").name == "a.parquet"
    assert place / "x" == as_location(str(place)) / "x"
    assert as_location(place) is place


@pytest.mark.parametrize("url", ["s3:/bucket/runs", "s3:bucket", "gs:/bucket/runs", "s3:"])
def test_a_url_without_its_slashes_is_no_folder(url: str) -> None:
    with pytest.raises(InputError, match=f"{url}: is neither a URL nor a folder.* {url[:3]}//BUCKET/PREFIX"):
        as_location(url)
    assert as_location(f"./{url}") == LocalLocation(Path(url)), "a folder of that name has a path"


def test_what_is_written_is_read(place: Location) -> None:
    file = place / "data" / "file"
    assert not file.is_file() and place.names() == [] and (place / "data").names() == []
    for missing in (file.read_bytes, file.size):
        with pytest.raises(FileNotFoundError):
            missing()
    file.write_atomic(b"old")
    file.write_atomic(b"new")
    (place / "top").write_atomic(b"")
    assert (file.read_bytes(), file.size(), file.read_text(), file.is_file()) == (b"new", 3, "new", True)
    assert place.names() == ["data", "top"] and (place / "data").names() == ["file"]
    assert not (place / "data").is_file()
    file.delete()
    file.delete()
    assert not file.is_file() and place.names().count("top") == 1


def test_a_folder_that_was_made_in_a_stores_console_is_empty(endpoint: str) -> None:
    bucket = new_bucket(endpoint)
    keys = {"aws_access_key_id": "test", "aws_secret_access_key": "test", "region_name": "us-east-1"}
    client = boto3.client("s3", endpoint_url=endpoint, **keys)
    for key in ("sweep/", "sweep/data/", "sweep/data/data"):
        client.put_object(Bucket=bucket, Key=key, Body=b"")
    place = as_location(f"s3://{bucket}/sweep")
    assert place.names() == ["data"] and (place / "data").names() == ["data"]
    assert as_location(f"s3://{bucket}").names() == ["sweep"]


def test_one_of_many_threads_creates_a_file(place: Location) -> None:
    for number in range(5):
        entry, start, won = place / f"{number}.json", threading.Barrier(8), []
        racers = [threading.Thread(target=_race, args=(entry, b"%d" % racer, start, won)) for racer in range(8)]
        for racer in racers:
            racer.start()
        for racer in racers:
            racer.join()
        assert won == [entry.read_bytes()]
    assert len(place.names()) == 5


def _race(entry: Location, name: bytes, start: threading.Barrier, won: list[bytes]) -> None:
    start.wait()
    if entry.put_if_absent(name):
        won.append(name)


def _create_all(place: Location, name: bytes, start: object) -> None:
    start.wait()  # type: ignore[attr-defined]
    won = [number for number in range(20) if (place / f"{number:02d}").put_if_absent(name)]
    (place / f"won-{name.decode()}").write_atomic(repr(won).encode())


def test_one_of_two_processes_creates_a_file(place: Location) -> None:
    start = multiprocessing.get_context("spawn").Barrier(2)
    racers = [
        multiprocessing.get_context("spawn").Process(target=_create_all, args=(place, name, start))
        for name in (b"a", b"b")
    ]
    for racer in racers:
        racer.start()
    for racer in racers:
        racer.join(60)
        assert racer.exitcode == 0
    there = {name: [n for n in range(20) if (place / f"{n:02d}").read_text() == name] for name in ("a", "b")}
    assert {name: (place / f"won-{name}").read_text() for name in there} == {k: repr(v) for k, v in there.items()}


def test_an_answer_that_was_lost_is_made_out_by_the_content(place: Location) -> None:
    entry = place / "entry"
    assert entry.put_if_absent(b"of driver 1")
    assert entry.put_if_absent(b"of driver 1"), "tried again since no answer came: it is there, and one's own"
    assert not entry.put_if_absent(b"of driver 2")
    assert entry.read_bytes() == b"of driver 1"


def test_each_keeps_the_order(place: Location) -> None:
    assert place.each(lambda item: item * 2, range(100)) == list(range(0, 200, 2))


def test_a_local_copy_holds_what_was_named(place: Location) -> None:
    for name in ("spec.yaml", "other"):
        (place / name).write_atomic(name.encode())
    (place / "final" / "auc.parquet").write_atomic(b"auc")
    with local_copy(place, ("final", "spec.yaml")) as folder:
        assert (folder / "spec.yaml").read_bytes() == b"spec.yaml"
        assert (folder / "final" / "auc.parquet").read_bytes() == b"auc"


def test_text_is_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert as_location("~/a b") == LocalLocation(tmp_path / "a b")
    assert as_location(tmp_path) == as_location(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert as_location("a").absolute() == as_location(tmp_path / "a")


@pytest.mark.parametrize("place", ["a\udcff", Path("a\udcff")])
def test_a_name_that_no_table_can_be_read_from_is_refused(place: str | Path) -> None:
    """The shell passes the byte 0xff, as in an archive of another system."""
    with pytest.raises(InputError, match=r"not UTF-8.*Rename"):
        as_location(place)


def test_a_file_is_read_from_any_place_in_it(place: Location) -> None:
    file = place / "data"
    with pytest.raises(FileNotFoundError):
        file.open()
    content = bytes(range(256)) * 8192
    file.write_atomic(content)
    with file.open() as opened:
        assert opened.seek(-3, 2) == len(content) - 3 and opened.read() == content[-3:] and opened.read() == b""
        assert opened.seek(1000) == 1000 and opened.read(5) == content[1000:1005] and opened.tell() == 1005
        opened.seek(0)
        assert opened.read() == content


def test_a_files_version_changes_with_it(place: Location) -> None:
    file = place / "data"
    assert file.version() == ""
    file.write_atomic(b"old")
    before = file.version()
    assert before and file.version() == before
    file.write_atomic(b"new")
    assert file.version() != before


def test_every_store_has_its_remedies() -> None:
    """A scheme of `object_store.STORES` has an entry in each table of `object_errors`."""
    assert set(object_errors.CREDENTIALS) == set(object_errors.CHECK) == set(STORES)
    with pytest.raises(InputError, match=" or ".join(f"{scheme}://BUCKET/PREFIX" for scheme in STORES)):
        as_location("ftp://bucket/runs")
