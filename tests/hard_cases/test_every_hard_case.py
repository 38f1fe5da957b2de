"""Every hard case must hold. `python tests/hard_cases/test_every_hard_case.py` lists the cases."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
from catalogue import AREAS, CASES, patience, table

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent))  # pytest sets this path; a direct run of this file needs it
for path in sorted(HERE.glob("cases_*.py")):
    importlib.import_module(path.stem)


@pytest.mark.parametrize("name", list(CASES))
def test_holds(name: str) -> None:
    with patience():
        CASES[name].check()


def test_every_area_has_cases() -> None:
    assert {case.area for case in CASES.values()} == set(AREAS)


if __name__ == "__main__":
    print(table())
