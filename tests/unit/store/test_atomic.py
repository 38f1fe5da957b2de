"""A file exists whole or not at all."""

from __future__ import annotations

import errno
import os
import socket
import zlib
from pathlib import Path

import pytest

from shift3d.store import atomic
from shift3d.store.atomic import UncertainError, leftovers, put_if_absent, write_atomic


def test_write_atomic_replaces_in_one_step(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    write_atomic(path, b"old")
    write_atomic(path, lambda temporary: temporary.write_bytes(b"new") and None)
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in path.parent.iterdir()] == ["file"]


def test_a_writer_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomic(path, b"old")

    def fails(temporary: Path) -> None:
        temporary.write_bytes(b"half")
        raise RuntimeError("out of ideas")

    with pytest.raises(RuntimeError):
        write_atomic(path, fails)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_put_if_absent_has_one_winner(tmp_path: Path) -> None:
    path = tmp_path / "entry"
    assert put_if_absent(path, b"first")
    assert not put_if_absent(path, b"second")
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["entry"]


def test_leftovers_are_of_dead_processes(tmp_path: Path) -> None:
    dead = tmp_path / ".tmp-4194400-scores"  # above the largest process id that Linux gives by default
    alive = tmp_path / f".tmp-{os.getpid()}-scores"
    dead.touch()
    alive.touch()
    assert leftovers(tmp_path) == [dead]
    assert leftovers(tmp_path / "absent") == []


def test_leftovers_are_of_this_machine(tmp_path: Path) -> None:
    here, elsewhere = tmp_path / ".tmp-4194400-{}00000000-scores", tmp_path / ".tmp-4194400-0000000100000000-scores"
    here = here.with_name(here.name.format(f"{zlib.crc32(socket.gethostname().encode()):08x}"))
    here.touch()
    elsewhere.touch()
    assert leftovers(tmp_path) == [here]


def test_a_folder_that_cannot_be_flushed_leaves_the_outcome_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flush = atomic._flush

    def fails(path: Path) -> None:
        if path.is_dir():
            raise OSError(errno.EIO, "I/O error")
        flush(path)

    monkeypatch.setattr(atomic, "_flush", fails)
    with pytest.raises(UncertainError, match="cannot be flushed"):
        put_if_absent(tmp_path / "entry", b"content")
    assert (tmp_path / "entry").read_bytes() == b"content"


def test_a_temporary_file_that_cannot_be_removed_does_not_undo_the_entry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The entry exists: an error would make the commit log delete the segments that the entry names."""

    def fails(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EIO, "I/O error")

    monkeypatch.setattr(Path, "unlink", fails)
    assert put_if_absent(tmp_path / "entry", b"content")
    assert (tmp_path / "entry").read_bytes() == b"content"
