"""References of a sweep: scene sets, weights, and every setting behind an accuracy preset."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest
import torch
import valid_sweeps
from safetensors.torch import save_file

import shift3d
from shift3d.detectors.grid import WAYMO_GRID
from shift3d.detectors.models.weights import NETWORKS
from shift3d.detectors.names import GRID_REACH_M
from shift3d.errors import InputError
from shift3d.render.settings import PRESETS
from shift3d.settings.catalogue.detector_files import scoring_detectors, weights_file
from shift3d.settings.catalogue.reading import Catalogue, accuracy_settings
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import AccuracyConfig, Config, DetectorConfig
from shift3d.settings.schema.scenes import KittiConfig, StreetConfig, scene_set
from shift3d.sweep.planning.plan import make_plan


@pytest.mark.parametrize("name", PRESETS)
def test_accuracy_states_every_setting_in_plain_values(name: str) -> None:
    settings = accuracy_settings(AccuracyConfig(name=name, render={}))  # type: ignore[arg-type]
    preset = PRESETS[name]
    assert settings.pop("detector") in ("bfloat16", "float32", "float64")
    assert settings.keys() == vars(preset).keys()
    for field, value in settings.items():
        assert isinstance(value, bool | int | float | str)
        expected = getattr(preset, field)
        assert getattr(torch, str(value)) == expected if field == "dtype" else value == expected


def test_accuracy_changes() -> None:
    settings = accuracy_settings(AccuracyConfig(name="standard", render={"step_m": 1}))
    assert settings["step_m"] == 1.0 and isinstance(settings["step_m"], float)
    assert accuracy_settings(AccuracyConfig(name="paper", render={"step_m": None}))["step_m"] == 0.1
    with pytest.raises(InputError, match="Did you mean 'step_m'"):
        accuracy_settings(AccuracyConfig(name="standard", render={"step": 0.1}))
    with pytest.raises(InputError, match=r"accuracy\.render\.step_m is 'far', not float"):
        accuracy_settings(AccuracyConfig(name="standard", render={"step_m": "far"}))


def test_street_scenes_by_settings() -> None:
    config = StreetConfig(kind="street", sensor="mixed", split="test", seed=0, count=3)
    assert len(scene_set(config).names()) == 3


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=str(tmp_path / "kitti")):
        scene_set(KittiConfig(kind="kitti", root=str(tmp_path / "kitti"), count=None, names=None)).names()
    with pytest.raises(InputError, match=r"absent\.safetensors: no weights of sst\. Check the path"):
        weights_file("sst", str(tmp_path / "absent.safetensors"))


def attacked(name: str, scored_by: list[str] | None, **weights: str | None) -> DetectorConfig:
    own = weights.pop(name, None)
    return DetectorConfig(name=name, weights=own, scored_by=scored_by, other_weights=weights)  # type: ignore[arg-type]


def test_the_attacked_detector_scores_first_and_always(tmp_path: Path) -> None:
    file = tmp_path / "sst.safetensors"
    save_file(NETWORKS["sst"]().state_dict(), file)
    every = {"pointpillars": None, "centerpoint": None, "sst": str(file)}
    assert list(scoring_detectors(attacked("pointpillars", None, sst=str(file))).items()) == list(every.items())
    assert list(scoring_detectors(attacked("sst", None, sst=str(file)))) == ["sst", "pointpillars", "centerpoint"]
    small = scoring_detectors(attacked("sst_small", None, sst=str(file)))
    assert list(small) == ["sst_small", *every], "attacked, it scores"
    assert scoring_detectors(attacked("sst", [], sst=str(file))) == {"sst": str(file)}
    assert list(scoring_detectors(attacked("sst", ["pointpillars", "sst"], sst=str(file)))) == ["sst", "pointpillars"]
    assert list(scoring_detectors(attacked("pointpillars", ["sst"], sst=str(file)))) == ["pointpillars", "sst"]


def test_a_detector_without_weights_is_left_out_unless_it_is_asked_for(tmp_path: Path) -> None:
    folder = Path(shift3d.__file__).parent / "weights"
    shipped = [name for name in ("pointpillars", "centerpoint", "sst") if (folder / f"{name}.safetensors").is_file()]
    assert list(scoring_detectors(attacked("pointpillars", None, sst=None))) == shipped
    with pytest.raises(InputError, match=r"absent: no weights of sst"):
        scoring_detectors(attacked("pointpillars", ["sst"], sst=str(tmp_path / "absent")))
    with pytest.raises(InputError, match=r"absent: no weights of sst"):
        scoring_detectors(attacked("sst", None, sst=str(tmp_path / "absent")))


def test_weights_that_are_none_are_refused_before_anything_runs(tmp_path: Path) -> None:
    other = weights_file("pointpillars", None)
    (tmp_path / "torn").write_bytes(other.read_bytes()[:1000])
    for file in (tmp_path / "torn", other):
        with pytest.raises(InputError, match=re.escape(str(file))):
            scoring_detectors(attacked("pointpillars", ["sst_small"], sst_small=str(file)))


def test_weights_below_the_home_folder_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.safetensors").write_bytes(weights_file("pointpillars", None).read_bytes())
    mine = attacked("pointpillars", [], pointpillars="~/mine.safetensors")
    assert scoring_detectors(mine) == {"pointpillars": "~/mine.safetensors"}


def test_weights_of_a_detector_that_scores_nowhere_are_refused() -> None:
    def planned(*words: str) -> None:
        given = ["vehicle=suv", "mode=shape", "detector.other_weights.sst=mine.safetensors", *words]
        make_plan(compose_sweep("default", given), catalogue)

    def catalogue(config: Config) -> Catalogue:
        scoring = dict.fromkeys(config.detector.named(), "p")
        return dataclasses.replace(valid_sweeps.catalogue(config), detectors=scoring)

    with pytest.raises(InputError, match=r"other_weights\.sst means nothing.*scored_by=\[pointpillars,sst\]"):
        planned()
    planned("detector.scored_by=[sst]")
    planned("detector.scored_by=[],[sst]")


def test_places_beyond_a_shipped_detectors_grid_are_refused_at_every_value_of_an_axis() -> None:
    def planned(*words: str) -> None:
        make_plan(compose_sweep("default", ["vehicle=suv", *words]), valid_sweeps.catalogue)

    planned("mode=shape", "attack.max_shift_m=150")
    planned("mode=pose", "attack.placement.max_range_m=70")
    with pytest.raises(InputError, match=r"moved by 150 m: pointpillars sees 75 m.*or attack\.max_shift_m"):
        planned("mode=pose", "attack.max_shift_m=4,150")
    with pytest.raises(InputError, match=r"put 80 m away: .*attack\.placement\.max_range_m$"):
        planned("mode=shape", "attack.placement.max_range_m=50,80")
    assert -WAYMO_GRID.x_min_m == -WAYMO_GRID.y_min_m == GRID_REACH_M
    assert WAYMO_GRID.num_x * WAYMO_GRID.cell_m == pytest.approx(2 * GRID_REACH_M)
