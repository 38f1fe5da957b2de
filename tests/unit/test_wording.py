"""Numbers with their nouns, sentences with one full stop, and one list of exit codes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode, exit_codes
from shift3d.store.log import TakenOverError
from shift3d.sweep.execution.abort import AbortedError
from shift3d.wording import counted


def words(text: str) -> str:
    return " ".join(text.split())


def test_one_is_one() -> None:
    assert [counted(number, "task") for number in (0, 1, 2)] == ["0 tasks", "1 task", "2 tasks"]
    assert counted(1, "entry", "entries") == "1 entry" and counted(3, "entry", "entries") == "3 entries"


def test_a_sentence_has_one_end() -> None:
    assert str(InputError("which sweep?", "status", "Name it")) == "status: which sweep? Name it"
    assert str(InputError("there is none", "here", "Make it")) == "here: there is none. Make it"


@pytest.mark.parametrize("workers", [1, 2])
def test_a_plan_of_one_task_speaks_of_one(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    one = ["smoke", "scenes.count=1", "vehicle=suv", "mode=shape", "attack.lambda=1", f"runner.workers={workers}"]
    assert main(["plan", *one]) == 0
    printed = capsys.readouterr().out
    assert "1 task (1 shape) of 1 vehicle in 1 scene" in printed and not re.search(r"\b1 (?!s\b)[a-z]+s\b", printed), (
        printed
    )


def test_exit_codes_are_one_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert (AbortedError.exit_code, TakenOverError.exit_code, InputError.exit_code) == (5, 4, 2)
    printed = exit_codes()
    assert [int(code) for code in re.findall(r"(?:^|[:;] )(\d+) ", printed)] == [int(code) for code in ExitCode]
    with pytest.raises(SystemExit):
        main(["--help"])
    assert printed in words(capsys.readouterr().out)
