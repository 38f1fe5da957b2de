"""Two small finished sweeps: one on a training street, whose objects are tuned on, one on a test street."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from cheap_sweeps import CHEAP, set_stable

from shift3d.cli.command import run_command
from shift3d.cli.commands import sweep


@pytest.fixture(scope="session")
def _attacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweeps") / "attacked"
    assert run_command(sweep.COMMAND, ["finetune", *CHEAP, "vehicle=suv,coupe", f"out={folder}"]) == 0
    set_stable(folder, {"suv": True, "coupe": False})
    return folder


@pytest.fixture
def attacked(_attacked: Path, tmp_path: Path) -> Path:
    """A sweep on a training street: the suv's objects stable, the coupe's not. A copy that a test may damage."""
    return Path(shutil.copytree(_attacked, tmp_path / "attacked"))


@pytest.fixture(scope="session")
def held_out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of the suv on a test street; tests only read it."""
    folder = tmp_path_factory.mktemp("sweeps") / "held_out"
    assert (
        run_command(sweep.COMMAND, ["finetune_held_out", *CHEAP, "vehicle=suv", "attack.steps=1", f"out={folder}"]) == 0
    )
    assert pq.read_table(folder / "final" / "solutions.parquet").num_rows == 2
    return folder
