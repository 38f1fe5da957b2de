"""A worker's assets, loaded once, and the tasks that were run on them; tests only read them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from short_tasks import SHORT, STREET, THERE, WIDE, make_spec

from shift3d.naturalness.build import load_reference
from shift3d.naturalness.sources import reference_source
from shift3d.task.assets import Assets, load_assets, render_settings
from shift3d.task.exchange import AssetsSpec, TaskResult
from shift3d.task.run import run_task
from shift3d.task.spec import TransferScene


@pytest.fixture(scope="session")
def assets() -> Assets:
    return load_assets(AssetsSpec(scenes=STREET))


@pytest.fixture(scope="session")
def referenced(assets: Assets) -> Assets:
    """The same assets with a small reference set of naturalness, and the grid that their tasks need."""
    assets.sdf_grid_of(make_spec(), render_settings(make_spec()))  # before a test empties the cache folder
    return dataclasses.replace(assets, reference=WIDE, _own_naturalness={})


@pytest.fixture(scope="session")
def shape(assets: Assets) -> TaskResult:
    return run_task(make_spec(), assets)


@pytest.fixture(scope="session")
def pose(assets: Assets) -> TaskResult:
    return run_task(make_spec("pose"), assets)


@pytest.fixture(scope="session")
def moved(assets: Assets) -> TaskResult:
    """The search of the shape task, and its result in another scene."""
    alone = dataclasses.replace(SHORT, random_replicates=0, noise_replicates=0)
    return run_task(make_spec(transfer_scenes=(TransferScene(THERE, ""),), attack=alone), assets)


@pytest.fixture(scope="session")
def wide_reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache folder with only the small reference set, to copy."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        load_reference(reference_source(WIDE), "test")
    return folder
