"""Every hard case, as the code is and with its safeguard taken out; and the list of them in docs/hard_cases.md.

After a case was added or reworded: `python tests/hard_cases/test_every_hard_case.py` writes the list again.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
from catalogue import CASES, HardCase, patience, table, without

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent))  # as pytest has it, for who runs this file
LIST = HERE.parents[1] / "docs" / "hard_cases.md"
for path in sorted(HERE.glob("cases_*.py")):
    importlib.import_module(path.stem)

_EVERY = pytest.mark.parametrize("name", list(CASES))


@_EVERY
def test_holds(name: str) -> None:
    with patience():
        CASES[name].check()


@_EVERY
def test_fails_without_its_safeguard(name: str) -> None:
    case = CASES[name]
    with without(case.edits):
        held = _holds(case)
    assert not held, "it holds without its safeguard"
    assert _holds(case), "it does not hold again with the safeguard back"


def _holds(case: HardCase) -> bool:
    try:
        with patience():
            case.check()
    except Exception:  # whatever goes wrong without the safeguard
        return False
    return True


def test_there_are_at_least_sixty() -> None:
    assert len(CASES) >= 60


def test_the_list_is_that_of_the_cases() -> None:
    assert LIST.read_text() == text(), "run: python tests/hard_cases/test_every_hard_case.py"


def text() -> str:
    head = (
        "# Hard cases\n\nMade by `python tests/hard_cases/test_every_hard_case.py`. "
        "Each is a test, run as the code is and with its safeguard taken out, where it must fail.\n\n"
    )
    return f"{head}{len(CASES)} cases.\n\n{table()}"


if __name__ == "__main__":
    LIST.write_text(text())
