"""Numbers with their nouns, sentences with one full stop, and one list of exit codes."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import shift3d
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode, exit_codes
from shift3d.store.log import TakenOverError
from shift3d.sweep.execution.abort import AbortedError
from shift3d.wording import counted

PACKAGE = Path(shift3d.__file__).parent


def words(text: str) -> str:
    return " ".join(text.split())


def test_one_is_one() -> None:
    assert [counted(number, "task") for number in (0, 1, 2)] == ["0 tasks", "1 task", "2 tasks"]
    assert counted(1, "entry", "entries") == "1 entry" and counted(3, "entry", "entries") == "3 entries"


def test_a_sentence_has_one_end() -> None:
    assert str(InputError("which sweep?", "status", "Name it")) == "status: which sweep? Name it"
    assert str(InputError("there is none", "here", "Make it")) == "here: there is none. Make it"


def test_a_remedy_says_what_to_do() -> None:
    """A remedy is a sentence of its own, beginning with a verb, after the full stop of the error."""
    no_verb = r"[^A-Z]|(Known|Every|Its?|Only|The|There|This|Workers)\b"
    wrong = [f"{file}: {text}" for file in PACKAGE.rglob("*.py") for text in remedies(file) if re.match(no_verb, text)]
    assert not wrong, wrong


def remedies(file: Path) -> Iterator[str]:
    """Yield the beginnings of remedies that are written out in InputError calls."""
    for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "InputError":
            for remedy in [*call.args[2:], *(word.value for word in call.keywords if word.arg == "remedy")]:
                first = remedy.values[0] if isinstance(remedy, ast.JoinedStr) else remedy
                if isinstance(first, ast.Constant):
                    yield first.value


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
