"""``shift3d gc`` and ``shift3d compact`` report their actions, and a dry run changes nothing."""

from __future__ import annotations

import errno
import tempfile
from pathlib import Path
from typing import NoReturn

import pytest
from valid_sweeps import plan, write_sweep

from shift3d.cli.main import main
from shift3d.store.log import CommitLog
from shift3d.store.log_entries import read_log
from shift3d.sweep.results.final import write_final


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    out = tmp_path / "out"
    write_sweep(out)
    return out


def files(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def final(folder: Path) -> dict[str, bytes]:
    write_final(folder, plan(), read_log(folder))
    return files(folder / "final")


def test_compact_says_what_it_does_and_final_stays(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = files(folder)
    assert main(["compact", str(folder), "--dry-run"]) == 0
    assert "3 log entries and 8 segments would become 1 entry and 4 segments" in capsys.readouterr().out
    assert files(folder) == before
    tables = final(folder)
    assert main(["compact", str(folder)]) == 0
    assert "became 1 entry and 4 segments; 10 files removed" in capsys.readouterr().out
    assert final(folder) == tables
    assert len(list((folder / "data").iterdir())) == 4


def test_gc_says_what_it_does(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    killed = CommitLog(folder, plan().spec_hash)
    orphan = folder / "data" / f"00000004-{killed.driver}-scores.parquet"
    orphan.write_bytes(b"")
    (folder / "data" / "notes").write_bytes(b"")
    CommitLog(folder, plan().spec_hash)
    before = files(folder)
    assert main(["gc", str(folder), "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert "1 segment that no log entry names" in printed and "would be removed" in printed and str(orphan) in printed
    assert "kept, not written by shift3d" in printed and files(folder) == before
    assert main(["gc", str(folder)]) == 0
    assert before.keys() - files(folder).keys() == {str(orphan)}


def test_the_sweeps_inside_a_sweep_are_looked_at_too(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    orphans = []
    for inner in ("verification", "patterns", "retrieval/street-1a2b"):
        write_sweep(folder / inner)
        killed = CommitLog(folder / inner, plan().spec_hash)
        orphans.append(folder / inner / "data" / f"00000004-{killed.driver}-scores.parquet")
        orphans[-1].write_bytes(b"")
        CommitLog(folder / inner, plan().spec_hash)
    (folder / "verification" / "notes").mkdir()
    before = files(folder)
    assert main(["gc", str(folder)]) == 0
    assert before.keys() - files(folder).keys() == set(map(str, orphans))


def test_a_read_only_disk_gets_an_advice_that_the_command_can_follow(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def read_only(*_: object, **__: object) -> NoReturn:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(tempfile, "mkdtemp", read_only)
    assert main(["compact", str(folder)]) == 2
    printed = capsys.readouterr().err
    assert "_log: the file system is read-only. Make it writable, or work on a copy" in printed
    assert "out=" not in printed.replace(str(folder), "")


def test_both_refuse_what_is_no_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("gc", "compact"):
        assert main([command, str(tmp_path)]) == 2
        assert "is not the output folder of a sweep" in capsys.readouterr().err
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert "--dry-run" in capsys.readouterr().out
