"""Detectors of other codebases among the settings: requirements, content of their ids, and their allowed uses."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import valid_sweeps
from foreign_cases import CASES, far
from pydantic import ValidationError

from shift3d.errors import InputError
from shift3d.settings.catalogue.detector_files import (
    detector_hash,
    detector_layouts,
    require_in_range,
    scoring_detectors,
)
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.settings.expand import expand
from shift3d.settings.schema.config import Config, DetectorConfig
from shift3d.sweep.planning.plan import make_plan

CASE = CASES["mmdet3d-centerpoint"]


def config(folder: Path, **changes: Any) -> DetectorConfig:
    folder.mkdir(exist_ok=True)
    file, weights = CASE.saved(folder)
    values = {"name": "mmdet3d", "weights": str(weights), "config": str(file), "scored_by": [], "other_weights": {}}
    return DetectorConfig(**values | changes)


def digest(settings: DetectorConfig) -> str:
    return detector_hash("mmdet3d", settings.weights, None, detector_layouts(settings)["mmdet3d"])


def test_the_command_line_names_it() -> None:
    words = ["detector.weights=a.pth", "detector.config=b.yaml", "vehicle=suv", "mode=shape"]
    for name in ("openpcdet", "mmdet3d"):
        (one,) = expand(compose_sweep("smoke", [f"detector={name}", *words]))
        assert (one.detector.name, one.detector.config, one.detector.weights) == (name, "b.yaml", "a.pth")


def test_its_id_is_what_config_and_weights_say_and_not_how_or_where(tmp_path: Path) -> None:
    first, second = config(tmp_path / "one"), config(tmp_path / "two")
    assert first.config and second.config
    text = Path(second.config).read_text()
    Path(second.config).write_text("# The same\n" + text.replace("-6.4, -6.4, -5.0", "-6.4,  -6.4, -5.00"))
    assert digest(first) == digest(second)
    Path(second.config).write_text(text.replace("-5.0, 6.4, 6.4, 3.0", "-4.0, 6.4, 6.4, 4.0"))
    assert digest(first) != digest(second)
    assert len({digest(first), *(digest(config(tmp_path / "one", intensity=value)) for value in (1.0, 2.0))}) == 3
    assert first.weights
    Path(first.weights).write_bytes(Path(first.weights).read_bytes() + b"0")
    assert digest(first) != digest(config(tmp_path / "three"))


def test_what_is_wrong_is_said_where_a_sweep_is_planned(tmp_path: Path) -> None:
    settings = config(tmp_path)
    assert list(scoring_detectors(settings)) == ["mmdet3d"]
    assert settings.config
    base = tmp_path / "_base_/models/pillars.py"
    base.write_text(base.read_text().replace("feat_channels=[8]", "feat_channels=[8, 8]"))
    with pytest.raises(InputError, match=r"pts_voxel_encoder\.pfn_layers\.1\.linear\.weight"):
        scoring_detectors(settings)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"config": None}, r"config is null, and the detector mmdet3d is made of it: detector\.config=FILE"),
        ({"weights": None}, "mmdet3d needs its weights"),
        ({"scored_by": ["openpcdet"]}, "one of openpcdet and mmdet3d"),
        ({"name": "pointpillars"}, "config means nothing without detector=openpcdet"),
        ({"name": "pointpillars", "config": None, "intensity": 1.0}, "intensity means nothing without"),
    ],
)
def test_what_belongs_together(changes: dict[str, Any], says: str, tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match=says):
        config(tmp_path, **changes)


def test_it_scores_beside_a_shipped_one(tmp_path: Path) -> None:
    weights = config(tmp_path).weights
    beside = config(
        tmp_path, name="pointpillars", weights=None, scored_by=["mmdet3d"], other_weights={"mmdet3d": weights}
    )
    assert list(scoring_detectors(beside)) == ["pointpillars", "mmdet3d"]


def test_vehicles_stand_within_its_range(tmp_path: Path) -> None:
    kitti = DetectorConfig(
        name="openpcdet", weights="w", config=str(CASES["openpcdet-pointpillar"].write(tmp_path / "kitti")),
        scored_by=[], other_weights={},
    )  # fmt: skip
    layouts = detector_layouts(kitti)
    require_in_range(layouts, (0.0, 0.4), (8.0, 12.0), 0.0)
    with pytest.raises(InputError, match=r"x -12 m, y -?0 m"):
        require_in_range(layouts, (0.0, 3.1415927), (12.0, 12.0), 0.0)
    with pytest.raises(InputError, match="openpcdet's range leaves out"):
        require_in_range(layouts, (0.0, 0.4), (8.0, 20.0), 0.0)
    wide, _ = far(CASE, tmp_path)
    layouts = detector_layouts(config(tmp_path / "far", config=str(wide)))
    require_in_range(layouts, (0.0, 3.1415927), (15.0, 50.0), 0.0)
    with pytest.raises(InputError, match=r"x -?\d+ m, y -?\d+ m and moved by 4 m, which mmdet3d.*attack\.max_shift_m"):
        require_in_range(layouts, (0.0, 3.1415927), (15.0, 50.0), 4.0)
    require_in_range(layouts, (0.0, 3.1415927), (15.0, 47.0), 4.0)


def test_every_distance_of_an_axis_is_held_against_its_range(tmp_path: Path) -> None:
    file, weights = CASE.saved(tmp_path)
    checked: list[float] = []

    def catalogue(config: Config) -> Catalogue:
        checked.append(config.shift_m)
        return dataclasses.replace(valid_sweeps.catalogue(config), detectors={"mmdet3d": "m"})

    words = ["vehicle=suv", "detector=mmdet3d", f"detector.weights={weights}", f"detector.config={file}"]
    make_plan(compose_sweep("default", [*words, "mode=shape,pose", "attack.max_shift_m=2,4"]), catalogue)
    assert checked == [0.0, 2.0, 4.0]


def test_weights_for_each_detector_of_an_axis_are_taken_where_it_is_attacked() -> None:
    words = ["vehicle=suv", "mode=pose", "detector=pointpillars,sst", "tracking=none"]
    words += ["+detector.other_weights.pointpillars=A", "+detector.other_weights.sst=B"]
    found = {
        config.detector.name: config.detector.weights_by_name() for config in expand(compose_sweep("default", words))
    }
    assert (found["pointpillars"]["pointpillars"], found["sst"]["sst"]) == ("A", "B")
