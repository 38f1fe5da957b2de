"""Fixtures of the tests of the analysis."""

from __future__ import annotations

from pathlib import Path

import pytest
import valid_sweeps

from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A handmade finished sweep; tests only read it."""
    folder = tmp_path_factory.mktemp("report") / "sweep"
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    return folder
