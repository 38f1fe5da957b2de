"""A task against a detector of another codebase: from the data sent to a worker to rows."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from foreign_ports import PORTS
from short_tasks import SHORT, STREET, make_spec

from shift3d.detectors.foreign.detector import foreign_layout
from shift3d.errors import InputError
from shift3d.settings.catalogue.detector_files import detector_hash
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.sweep.execution.ray.shipped_files import NamedFiles, named_files
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec
from shift3d.task.run import run_task

CODEBASES = ("openpcdet", "mmdet3d")
# The first step has the same length in a direction without gradient as in any other, so rounding changes the result.
NEAR = {"openpcdet": 6e-2, "mmdet3d": 5e-2}


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> AssetsSpec:
    """Data sent to a worker: PointPillars in both codebases' layouts, and as shipped."""
    files, layouts = {}, {}
    for codebase in CODEBASES:
        port = PORTS[f"{codebase}-pointpillars"]
        config, weights = port.saved(tmp_path_factory.mktemp(codebase))
        layouts[codebase] = json.loads(json.dumps(foreign_layout(codebase, config, port.choices)))
        config.unlink()  # a worker has no config file
        files[codebase] = str(weights)
    hashes = {name: detector_hash(name, files[name], None, layouts[name]) for name in CODEBASES}
    return AssetsSpec(scenes=STREET, detectors={**files, "pointpillars": None}, hashes=hashes, layouts=layouts)


@pytest.fixture(scope="module")
def assets(assets: Assets, sent: AssetsSpec) -> Assets:
    return dataclasses.replace(load_assets(sent), _scenes=assets._scenes)


def attacked(detector: str, assets: Assets) -> dict[str, dict[str, Any]]:
    """Return the rows of a short attack, by method."""
    attack = dataclasses.replace(SHORT, noise_replicates=0, random_replicates=0)
    accuracy = accuracy_settings(AccuracyConfig(name="standard", render={"sdf_grid": False}))
    task = make_spec(detector=detector, scored_by=(detector,), attack=attack, accuracy_settings=accuracy)
    return {row["method"]: row for row in run_task(task, assets).scores}


@pytest.fixture(scope="module")
def shipped(assets: Assets) -> dict[str, dict[str, Any]]:
    return attacked("pointpillars", assets)


@pytest.mark.parametrize("codebase", CODEBASES)
def test_an_attack_on_it_is_the_attack_on_the_shipped_one(
    codebase: str, assets: Assets, shipped: dict[str, dict[str, Any]]
) -> None:
    found = attacked(codebase, assets)
    assert set(found) == {"baseline", "adversarial"}
    assert {row["scored_by"] for row in found.values()} == {codebase}
    assert found["adversarial"]["adversarial_loss"] < 0.95 * found["baseline"]["adversarial_loss"]
    for method, row in found.items():
        for column in ("score", "adversarial_loss", "latent_distance"):
            near = NEAR[codebase] if method == "adversarial" else 1e-4
            assert row[column] == pytest.approx(shipped[method][column], rel=near, abs=near)


def test_checkpoints_travel_and_configs_do_not(sent: AssetsSpec) -> None:
    wanted = {NamedFiles(str(Path(str(sent.detectors[name])).parent), ("port.pth",)) for name in CODEBASES}
    assert set(named_files(sent)) == wanted


def test_another_layout_than_planned_is_refused(sent: AssetsSpec) -> None:
    layout = dict(sent.layouts["mmdet3d"]) | {"suppression_iou": 0.5}
    with pytest.raises(InputError, match="changed after the sweep was planned"):
        load_assets(dataclasses.replace(sent, layouts={**sent.layouts, "mmdet3d": layout}))
