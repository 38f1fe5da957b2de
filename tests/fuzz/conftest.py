"""Prints the outcomes of the mutants by kind of input, at the end of the tests."""

from __future__ import annotations

import pytest
from feeding import REPORTS


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not REPORTS:
        return
    terminalreporter.section("mutants")
    rows = [(name, r.counts(), len(r.outcomes), r.seconds) for name, r in REPORTS.items()]
    for name, counts, total, seconds in rows:
        message = f"{counts['error']:5d} clear errors {counts['valid']:5d} valid {counts['failed']:4d} failed"
        terminalreporter.line(f"{name:32s} {total:5d} mutants {message} {seconds:6.1f} s")
    errors, valid = (sum(counts[what] for _, counts, _, _ in rows) for what in ("error", "valid"))
    total = sum(count for _, _, count, _ in rows)
    seconds = sum(taken for *_, taken in rows)
    terminalreporter.line(f"{'all':32s} {total:5d} mutants {errors:5d} clear errors {valid:5d} valid, {seconds:.0f} s")
