"""Options of street scenes: contradictions are refused, names contain all, and settings are the generator's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from shift3d.errors import InputError
from shift3d.scenes.sets import StreetScenes, independent_group_of
from shift3d.scenes.street.options import PLAIN, StreetOptions
from shift3d.settings.schema.scenes import StreetConfig, StreetOptionsConfig, scene_set

CONF = Path(__file__).parents[3] / "conf" / "scenes" / "street.yaml"
EVERY: list[tuple[dict[str, Any], str]] = [
    ({}, ""),
    ({"weather": "fog", "visibility_m": 50}, "-fog50"),
    ({"weather": "fog"}, "-fog100"),
    ({"weather": "rain", "rain_mm_h": 2.5}, "-rain2.5"),
    ({"weather": "snow", "snow_mm_h": 1e-7}, "-snow0.0000001"),
    ({"sensor_model": True, "range_image": True}, "-model-image"),
    ({"returns": 2, "ego_speed_m_s": 15.0}, "-returns2-ego15"),
    ({"sensors": 3, "ego_speed_m_s": 1 / 3, "motion_compensated": True}, "-sensors3-ego0.3333333333333333comp"),
    ({"weather": "fog", "sensor_model": True, "range_image": True, "returns": 2}, "-fog100-model-image-returns2"),
    ({"traffic": "wide"}, "-wide"),
    ({"returns": 2, "traffic": "held_out"}, "-returns2-held_out"),
]
WRONG: list[tuple[dict[str, Any], str, str]] = [
    ({"visibility_m": 50.0}, "visibility_m=50.0", "weather=fog"),
    ({"weather": "fog", "rain_mm_h": 5.0}, "rain_mm_h=5.0", "weather=rain"),
    ({"weather": "rain", "visibility_m": 50.0, "rain_mm_h": 5.0}, "visibility_m=50.0", "leave visibility_m null"),
    ({"returns": 2, "sensors": 3}, "returns=2 with sensors=3", "Set one of them to 1"),
    ({"motion_compensated": True}, "motion_compensated=true", "Give ego_speed_m_s"),
]
OUT_OF_RANGE: list[dict[str, Any]] = [
    {"weather": "hail"},
    {"weather": "fog", "visibility_m": 0.0},
    {"weather": "rain", "rain_mm_h": float("nan")},
    {"weather": "snow", "snow_mm_h": float("inf")},
    {"returns": 3},
    {"sensors": 0},
    {"sensors": 6},
    {"traffic": "rush hour"},
    {"ego_speed_m_s": -1.0},
    {"ego_speed_m_s": float("nan")},
]


def street(**options: Any) -> StreetConfig:
    return StreetConfig(kind="street", sensor="hdl64", split="test", seed=0, count=2, **options)


@pytest.mark.parametrize(("values", "tag"), EVERY)
def test_a_tag_tells_the_options(values: dict[str, Any], tag: str) -> None:
    options = StreetOptions(**values)
    assert options.tag == tag


@pytest.mark.parametrize("values", [*(values for values, _ in EVERY), {"beams": "hdl32"}])
def test_a_street_lies_in_one_place_whatever_its_options(values: dict[str, Any]) -> None:
    for seed, tail in ((0, ""), (3, "-seed3")):
        scenes = StreetScenes("mixed", seed, 2, options=StreetOptions(**values))
        places = [independent_group_of(scenes.dataset, name) for name in scenes.names()]
        expected = ["street-hdl64/street-test-hdl64-000000", "street-waymo_top/street-test-waymo_top-000001"]
        assert places == [f"{place}{tail}" for place in expected]
        assert places[0] == independent_group_of(f"street-hdl64{scenes.options.tag}", scenes.names()[0]), (
            "a set of one sensor"
        )
    assert independent_group_of("kitti", "street-000001-fog") == "kitti/street-000001-fog"


@pytest.mark.parametrize(("values", "what", "remedy"), WRONG)
def test_contradictions_name_the_field_and_the_remedy(values: dict[str, Any], what: str, remedy: str) -> None:
    with pytest.raises(InputError) as caught:
        StreetOptions(**values)
    assert what in caught.value.what and remedy in caught.value.remedy
    with pytest.raises(ValidationError) as refused:
        street(**values)
    assert what in str(refused.value) and remedy in str(refused.value)


@pytest.mark.parametrize("values", OUT_OF_RANGE)
def test_values_out_of_range_are_refused_by_both(values: dict[str, Any]) -> None:
    name = list(values)[-1]
    with pytest.raises(InputError, match=name):
        StreetOptions(**values)
    with pytest.raises(ValidationError, match=name):
        street(**values)


def test_settings_are_those_of_the_generator_and_off_by_default() -> None:
    assert street().options() == PLAIN
    shipped = yaml.safe_load(CONF.read_text())
    names = StreetOptionsConfig.model_fields
    assert {name: shipped[name] for name in names} == {name: getattr(PLAIN, name) for name in names}
    assert set(names) == set(vars(PLAIN))
    config = street(weather="fog", visibility_m=50, returns=2)
    assert scene_set(config).dataset == "street-hdl64-fog50-returns2"
    # As a task carries them, and as its worker reads them.
    dumped = config.model_dump(mode="json")
    assert StreetConfig(**dumped) == config


def test_names_carry_the_options_and_are_checked() -> None:
    foggy = StreetOptions(weather="fog", visibility_m=50.0)
    scenes = StreetScenes("mixed", seed=3, count=2, options=foggy)
    assert scenes.dataset == "street-mixed-fog50"
    assert scenes.names() == ["street-test-hdl64-000000-fog50-seed3", "street-test-waymo_top-000001-fog50-seed3"]
    scene = scenes.load(scenes.names()[0])
    assert (scene.scene_id, scene.dataset) == (scenes.names()[0], "street-hdl64-fog50")
    for name in ("street-test-hdl64-000000-seed3", "street-test-hdl64-000000-fog60-seed3", "street-test-hdl64-000000"):
        with pytest.raises(InputError, match="unknown scene"):
            scenes.load(name)
    with pytest.raises(InputError, match="unknown scene"):
        StreetScenes("hdl64").load("street-test-hdl64-000000-fog50")
