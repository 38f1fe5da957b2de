"""Facts of a street's scenes from its configuration equal those from the generated scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from shift3d.effects.applicability import NEEDS, choose
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.scenes.sets import StreetScenes
from shift3d.scenes.street.options import StreetOptions

READER = DetectorFacts("a reader", reads_reflectance=True)
STATED = (
    EffectSettings(),
    EffectSettings(object_speed_m_s=8.0),
    EffectSettings(visibility_m=60.0, range_noise_m=0.02),
    EffectSettings(rain_mm_h=20.0, limit_range_m=60.0, divergence_rad=3e-3),
)
OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"weather": "rain", "sensor_model": True},
    {"weather": "fog", "visibility_m": 50.0},
    {"range_image": True, "returns": 2},
    {"sensors": 5, "sensor_model": True},
    {"ego_speed_m_s": 15.0},
    {"ego_speed_m_s": 15.0, "motion_compensated": True},
)


def decided(facts: SceneFacts, overrides: EffectSettings) -> list[tuple[str, bool]]:
    choices = choose("auto", facts.described(overrides), READER)
    return [(choice.effect, choice.used) for choice in choices]


@pytest.mark.parametrize(
    ("seed", "options"),
    [pytest.param(7 * (n % 2), some, id=StreetOptions(**some).tag or "plain") for n, some in enumerate(OPTIONS)],
)
def test_the_configuration_decides_as_the_made_scene_does(seed: int, options: dict[str, Any]) -> None:
    scenes = StreetScenes("mixed", seed, count=2, start=seed, options=StreetOptions(**options))
    for name in scenes.names():
        made = scenes.load(name)
        dataset, facts = scenes.configured(name)
        seen = SceneFacts.of(made)
        assert (dataset, facts.scene_id) == (made.dataset, made.scene_id)
        assert (
            bool(facts.no_return_beams) == bool(seen.no_return_beams) and facts.no_return_beams <= seen.no_return_beams
        )
        assert facts.scan_s == pytest.approx(seen.scan_s, rel=1e-2)
        assert replace(facts, no_return_beams=0, scan_s=0.0) == replace(seen, no_return_beams=0, scan_s=0.0)
        for name, need in NEEDS.items():
            assert need.present(facts) == need.present(seen), name
        for overrides in STATED:
            if overrides.overrides().keys() & {"visibility_m", "rain_mm_h"} and made.conditions.weather != "dry":
                continue
            assert decided(facts, overrides) == decided(seen, overrides)


@pytest.mark.parametrize(
    ("own", "settings", "weather"),
    [
        ({"weather": "snow", "snow_mm_h": 1.0}, {"rain_mm_h": 0.0}, "snow"),
        ({"weather": "snow", "snow_mm_h": 1.0}, {"snow_mm_h": 0.0}, "dry"),
        ({"weather": "snow", "snow_mm_h": 1.0}, {"snow_mm_h": 0.0, "rain_mm_h": 5.0}, "rain"),
        ({"weather": "rain", "rain_mm_h": 10.0}, {"rain_mm_h": 2.0}, "rain"),
        ({"weather": "rain", "rain_mm_h": 10.0}, {"rain_mm_h": 0.0}, "dry"),
        ({"weather": "fog", "visibility_m": 40.0}, {"snow_mm_h": 0.0}, "fog"),
        ({}, {"rain_mm_h": 0.0}, "dry"),
    ],
)
def test_a_street_keeps_its_weather_where_another_has_no_rate(
    own: dict[str, Any], settings: dict[str, float], weather: str
) -> None:
    facts = SceneFacts("a street", conditions=Conditions(**own, weather_in_points=False))
    assert facts.described(EffectSettings(**settings)).conditions.weather == weather
