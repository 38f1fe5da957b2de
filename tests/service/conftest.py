"""Sweeps shared by tests: in a folder of their own, undisturbed, and finished copies to damage."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from drivers import Drivers


@pytest.fixture
def drivers(tmp_path: Path) -> Iterator[Drivers]:
    found = Drivers(tmp_path)
    yield found
    found.kill_all()


@pytest.fixture(scope="session")
def undisturbed_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An undisturbed sweep, in process."""
    drivers = Drivers(tmp_path_factory.mktemp("undisturbed"))
    code, _, errors = drivers.run("out", "runner=local")
    assert code == 0, errors
    return drivers.folder / "out"


@pytest.fixture(scope="session")
def undisturbed(undisturbed_folder: Path) -> dict[str, bytes]:
    """Files of its final/ folder."""
    return Drivers(undisturbed_folder.parent).final("out")


@pytest.fixture
def finished(drivers: Drivers, undisturbed_folder: Path) -> Path:
    """A copy of the undisturbed sweep that a test may damage."""
    return Path(shutil.copytree(undisturbed_folder, drivers.folder / "out"))
