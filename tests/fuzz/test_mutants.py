"""Thousands of damaged files: each gives a clear error or a valid result, and nothing else.

The damage is drawn from (kind, seed), so that a failure can be replayed: `python tests/fuzz/replay.py KIND SEED` makes
the mutant, loads it and shows the traceback.
"""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
from feeding import KINDS, feed

for path in sorted(Path(__file__).parent.glob("kinds_*.py")):
    importlib.import_module(path.stem)


@pytest.mark.parametrize("name", list(KINDS))
def test_a_clear_error_or_a_valid_result(name: str) -> None:
    report = feed(KINDS[name])
    counts = report.counts()
    print(f"{name}: {len(report.outcomes)} mutants, {dict(counts)}, {report.seconds:.1f} s")
    failures = report.failures()
    assert not failures, f"{len(failures)} of {len(report.outcomes)}:\n" + "\n".join(failures[:20])
    assert len(report.outcomes) == KINDS[name].count
    # The loader must neither refuse everything nor accept everything.
    assert counts["error"] and counts["valid"]


def test_there_are_at_least_two_thousand() -> None:
    assert sum(kind.count for kind in KINDS.values()) >= 2000
