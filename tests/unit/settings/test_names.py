"""Numbers that name things are names."""

from __future__ import annotations

from pathlib import Path

import pytest

from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep
from shift3d.settings.expand import expand
from shift3d.settings.names import quoted, text_setting_paths
from shift3d.settings.schema.config import Config, DeepSdfVehicleConfig, MlflowConfig
from shift3d.settings.schema.scenes import KittiConfig

DEEPSDF = ["vehicle=deepsdf", "vehicle.folder=here", "mode=shape", "attack.lambda=1"]
KITTI = ["scenes.root=here", "vehicle=suv", "mode=shape", "attack.lambda=1"]


def vehicles(*words: str) -> list[DeepSdfVehicleConfig]:
    return [config.vehicle for config in expand(compose_sweep("default", [*DEEPSDF, *words]))]  # type: ignore[misc]


def test_the_texts_among_the_settings() -> None:
    assert text_setting_paths(Config) == {
        *(
            "scene",
            "scenes.root",
            "scenes.names",
            "scenes.version",
            "scenes.split",
            "vehicle.name",
            "vehicle.folder",
            "vehicle.checkpoint",
            "naturalness.folder",
        ),
        *("detector.weights", "detector.module", "detector.file", "detector.config", "detector.vehicle_class"),
        *("runner.address", "tracking.uri", "tracking.experiment"),
        "attack.edit",
    }


@pytest.mark.parametrize("written", ["2000", "'2000'", '"2000"'])
def test_an_epoch_is_a_name(written: str) -> None:
    (vehicle,) = vehicles("vehicle.name=car", f"vehicle.checkpoint={written}")
    assert vehicle.checkpoint == "2000"


def test_names_stay_as_they_were_written() -> None:
    names = ["1e5", "007", "1_000", "10.50", "-3", "7", "suv"]
    assert [vehicle.name for vehicle in vehicles(f"vehicle.name={','.join(names)}")] == names
    (vehicle,) = vehicles("vehicle.name=3", "vehicle.length_m={3:4.5,van:4.9}")
    assert vehicle.name == "3" and vehicle.length_m == {"3": 4.5, "van": 4.9}


def test_frames_are_names() -> None:
    words = [*KITTI, "scenes.names=[999999, 000001,12]", "scene=12", "tracking.experiment=2026"]
    (config,) = expand(compose_sweep("kitti", words))
    assert isinstance(config.scenes, KittiConfig) and config.scenes.names == ["999999", "000001", "12"]
    assert isinstance(config.tracking, MlflowConfig)
    assert (config.scene, config.tracking.experiment) == ("12", "2026")
    (config,) = expand(compose_sweep("kitti", [*KITTI, "scene=null"]))
    assert config.scene is None


def test_numbers_of_a_file_are_names_too() -> None:
    config = KittiConfig.model_validate({"kind": "kitti", "root": 7, "count": None, "names": ["000001"]})
    assert (config.root, config.names) == ("7", ["000001"])


@pytest.mark.parametrize("written", ["010", "2023_10_05", "12:30:00", "1e5"])
@pytest.mark.parametrize("in_small", [False, True])
def test_frames_of_a_file_without_quotes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: str, in_small: bool
) -> None:
    """YAML parses unquoted digits as other numbers."""
    (tmp_path / "sweeps").mkdir()
    monkeypatch.chdir(tmp_path)
    defaults = "defaults: [smoke, {override /scenes: kitti}, _self_]\n"
    listed = f"small: {{scenes.names: [{written}]}}" if in_small else f"scenes: {{names: [{written}]}}"
    (tmp_path / "sweeps" / "mine.yaml").write_text(f"{defaults}{listed}\n")
    size = ["size=small"] if in_small else []
    with pytest.raises(InputError, match=r"scenes\.names\S* is \d.*Put names in quotes"):
        list(expand(compose_sweep("mine", ["scenes.root=here", *size])))
    config = next(expand(compose_sweep("mine", ["scenes.root=here", f"scenes.names=[{written}]"])))
    assert isinstance(config.scenes, KittiConfig) and config.scenes.names == [written]


@pytest.mark.parametrize(
    ("word", "same"),
    [
        ("attack.steps=3", True),
        ("scenes.count=3,4", True),
        ("scenes.root=/data/2026", True),
        ("vehicle.name=car-7", True),
        ("vehicle.name='a, 5'", True),
        ("+scene=5", False),
        ("scenes.names=[5]", False),
    ],
)
def test_only_numbers_of_texts_are_quoted(word: str, same: bool) -> None:
    assert (quoted(word, text_setting_paths(Config)) == word) is same


@pytest.mark.parametrize(
    "root", ["/tmp/\u00f1and\u00fa 2/\u8eca", "data/date=2024-05-01", "~me/A&B #1", "C:/a!b;c", "/data/2026"]
)
def test_a_path_of_any_letters_is_itself(root: str) -> None:
    (config,) = expand(compose_sweep("kitti", [*KITTI, f"scenes.root={root}"]))
    assert isinstance(config.scenes, KittiConfig) and config.scenes.root == root


def test_lists_and_axes_of_any_letters() -> None:
    (config,) = expand(compose_sweep("kitti", [*KITTI, "scenes.names=[\u00e9=1, 007]"]))
    assert isinstance(config.scenes, KittiConfig) and config.scenes.names == ["\u00e9=1", "007"]
    found = expand(compose_sweep("kitti", [*KITTI, "scene=\u00e9 1,2,b=3"]))
    assert [config.scene for config in found] == ["\u00e9 1", "2", "b=3"]


@pytest.mark.parametrize("word", ["vehicle.name=true", "attack.steps=many", "mode=3", "scenes.root=[1]"])
def test_what_is_no_name_is_refused(word: str) -> None:
    with pytest.raises(InputError):
        list(expand(compose_sweep("kitti", [*KITTI, word])))
