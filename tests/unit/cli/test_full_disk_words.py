"""A full disk: a command that resumes says so, another one does not."""

from __future__ import annotations

import resource
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import valid_frames

from shift3d.cli.main import main

KITTI = ["scenes.count=null", "vehicle=suv", "mode=shape", "attack.lambda=1", "runner=local", "tracking=none"]


@pytest.fixture
def frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Words of the data set. Afterwards no file of this process may exceed 1 kB, so that the write itself fails."""
    monkeypatch.chdir(tmp_path)
    # Python 3.11 would leave truncated .pyc files of modules imported meanwhile, and fail on them later.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    valid_frames.write_frame(tmp_path / "kitti")
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))
    yield "scenes.root=kitti"
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(words) == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_a_sweep_resumes(frame: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(["sweep", "kitti", frame, *KITTI, "out=out"], capsys)
    assert "spec.yaml: the file would pass the size limit" in line
    assert line.endswith("run the same command again: it resumes")


def test_a_picture_does_not(frame: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(["scenes", "show", "scenes=kitti", frame, "out=scene.png"], capsys)
    assert "scene.png: the file would pass the size limit" in line
    assert line.endswith("run the same command again")
    assert [path.name for path in Path().iterdir()] == ["kitti"], "nothing half-written"
