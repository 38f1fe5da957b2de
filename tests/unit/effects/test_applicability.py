"""Effects that a scene calls for: by its data alone, in one order, at no cost if no effect applies."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest

from shift3d.effects import applicability
from shift3d.effects.applicability import IMPACT_BOUND, NEEDS, Choice, choose
from shift3d.errors import InputError
from shift3d.scenes.facts import EFFECT_SETTINGS, DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import NoReturnBeams, SensorModel

COUNT = 60
COORDINATES = DetectorFacts("coordinates")
READER = DetectorFacts("reader", reads_reflectance=True)
LOST = 80.0
"""A limit range, m, at which a vehicle's dark parts are lost at 50 m."""


def dry_scene() -> Scene:
    """Return a scene with one origin, one return per beam, on the ground; no sensor, times, pixels, reflectance."""
    rng = np.random.default_rng(1)
    points = np.column_stack((rng.uniform(5, 40, (COUNT, 2)), np.full(COUNT, -1.7))).astype(np.float32)
    return Scene("dry street", "made", points, np.zeros((COUNT, 3), np.float32), -1.7)


def with_data(*names: str) -> Scene:
    """Return the dry scene with additional data for each of `names`."""
    scene = dry_scene()
    half = np.arange(COUNT) % 2
    pixels = np.stack((np.zeros(COUNT), np.arange(COUNT) // 2), 1).astype(np.int32)
    sensor, conditions = SensorModel(), scene.conditions
    for name in names:
        if name == "origins":
            scene = dataclasses.replace(scene, origins=np.stack((half, half, half), 1).astype(np.float32))
        elif name == "no_return_beams":
            up = np.array([[0.0, 0.0, 1.0]], np.float32)
            scene = dataclasses.replace(scene, no_return=NoReturnBeams(np.zeros((1, 3), np.float32), up))
        elif name == "rolling_shutter":
            scene = dataclasses.replace(scene, time_s=np.linspace(0.0, 0.1, COUNT, dtype=np.float32))
            conditions = dataclasses.replace(conditions, ego_velocity_m_s=(15.0, 0.0, 0.0), motion_compensated=False)
        elif name == "second_returns":
            scene = dataclasses.replace(scene, return_number=half.astype(np.uint8), range_image_index=pixels)
        elif name == "reflectance":
            scene = dataclasses.replace(scene, reflectance=np.full(COUNT, 0.2, np.float32))
        elif name == "divergence":
            sensor = dataclasses.replace(sensor, divergence_rad=3e-3)
        elif name == "ray_drop":
            sensor = dataclasses.replace(sensor, limit_range_m=LOST)
        elif name == "range_noise":
            sensor = dataclasses.replace(sensor, range_noise_m=0.02)
        elif name == "fog":
            conditions = dataclasses.replace(conditions, weather="fog", visibility_m=40.0)
        elif name == "rain":
            conditions = dataclasses.replace(conditions, weather="rain", rain_mm_h=40.0)
        elif name == "snow":
            conditions = dataclasses.replace(conditions, weather="snow", snow_mm_h=5.0)
        else:
            raise AssertionError(f"with_data: add a branch with the scene's data for {name}")
    scene = dataclasses.replace(scene, sensor=sensor, conditions=conditions)
    scene.validate()
    return scene


ALONE = [name for name in NEEDS if name != "wet_ground"]
"""Effects with data of their own; wet ground needs both rain and a known limit."""


def called(scene: Scene, detector: DetectorFacts = COORDINATES, settings: EffectSettings | None = None) -> list[Choice]:
    return choose("auto", SceneFacts.of(scene, settings or EffectSettings()), detector)


def names(choices: list[Choice]) -> list[str]:
    assert all(choice.used for choice in choices)
    return [choice.effect for choice in choices]


@pytest.fixture(autouse=True)
def impact_file(monkeypatch, tmp_path):
    """No effect has a measured impact except those that a test writes into this file."""
    file = tmp_path / "effects.json"
    monkeypatch.setattr(applicability, "MEASURED_IMPACT", file)
    applicability.measured_impact.cache_clear()
    yield file
    applicability.measured_impact.cache_clear()


def measured(file, **high: float) -> None:
    rows = {
        name: {"score_change": 0.5 * value, "low": 0.0, "high": value, "milliseconds": 2.5}
        for name, value in high.items()
    }
    file.write_text(json.dumps({"effects": rows}), encoding="utf-8")
    applicability.measured_impact.cache_clear()


def test_a_dry_scene_calls_for_nothing():
    assert called(dry_scene()) == []
    assert choose([], SceneFacts.of(dry_scene()), COORDINATES) == []


_FRESH = """
import sys
from shift3d.effects.applicability import choose
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.sensor import SensorModel
noise = float(sys.argv[1]) or None
facts = SceneFacts("fresh", has_reflectance=True, sensor=SensorModel(range_noise_m=noise))
print([choice.effect for choice in choose("auto", facts, DetectorFacts("coordinates"))])
print(sorted(name for name in sys.modules if name.startswith("shift3d.effects")))
"""


def fresh(noise_m: float) -> tuple[list[str], list[str]]:
    """Return, from a new process, the effects called for and the imported modules of `render.effects`."""
    done = subprocess.run([sys.executable, "-c", _FRESH, str(noise_m)], capture_output=True, text=True, check=True)
    first, second = (json.loads(line.replace("'", '"')) for line in done.stdout.splitlines())
    return first, second


def test_no_effect_is_imported_where_none_applies():
    own = ["shift3d.effects", "shift3d.effects.applicability"]
    assert fresh(0.0) == ([], own)


def test_other_effects_are_not_imported_with_the_one_that_applies():
    effects, modules = fresh(0.02)
    assert effects == ["range_noise"]
    assert {name.rpartition(".")[2] for name in modules} & set(NEEDS) == {"range_noise"}


@pytest.mark.parametrize("name", ALONE)
def test_an_effect_applies_in_the_scene_that_has_its_data(name):
    choices = called(with_data(name), READER)
    assert names(choices) == [name]
    assert any(letter.isdigit() for letter in choices[0].reason) or name == "reflectance"
    assert choices[0].milliseconds is None


def laid_over(scene: Scene) -> Scene:
    """Return the scene with its weather not yet in its points."""
    return dataclasses.replace(scene, conditions=dataclasses.replace(scene.conditions, weather_in_points=False))


def test_wet_ground_applies_in_rain_that_is_not_in_the_points_and_a_known_limit():
    scene = with_data("rain", "ray_drop")
    assert names(called(laid_over(scene))) == ["wet_ground", "rain", "ray_drop"]
    assert names(called(scene)) == ["rain", "ray_drop"]  # the points were measured over wet ground


def test_reflectance_applies_for_detectors_that_read_it_alone():
    assert names(called(with_data("reflectance"), COORDINATES)) == []
    assert names(called(with_data("reflectance"), READER)) == ["reflectance"]


def test_return_numbers_without_pixels_pair_nothing():
    scene = dataclasses.replace(with_data("second_returns"), range_image_index=None)
    assert called(scene) == []
    with pytest.raises(InputError, match="return numbers and pixels"):
        choose(["second_returns"], SceneFacts.of(scene), COORDINATES)


def test_a_scene_with_everything_calls_for_all_in_the_order_of_the_physics():
    assert names(called(laid_over(with_data(*ALONE)), READER)) == list(NEEDS)


def test_the_order_of_a_list_does_not_matter():
    facts = SceneFacts.of(with_data(*ALONE))
    for wanted in (list(NEEDS), list(NEEDS)[::-1], [*NEEDS, *NEEDS]):
        assert names(choose(wanted, facts, COORDINATES)) == list(NEEDS)
    assert names(choose(["range_noise", "origins"], facts, COORDINATES)) == ["origins", "range_noise"]


@pytest.mark.parametrize("name", NEEDS)
def test_a_forced_effect_without_data_says_what_is_missing(name):
    others = [other for other in ALONE if other != name and (name, other) != ("wet_ground", "rain")]
    for scene in (dry_scene(), with_data(*others)):
        with pytest.raises(InputError) as caught:
            choose([name], SceneFacts.of(scene), READER)
        message = str(caught.value)
        assert "dry street" in message and name in message
        assert NEEDS[name].lacking in message and NEEDS[name].remedy in message


def test_remedies_name_settings_that_exist():
    for need in NEEDS.values():
        words = [word.strip(".,;") for word in need.remedy.split() if word.startswith("effects.")]
        for word in words:
            assert word.removeprefix("effects.") in EFFECT_SETTINGS


def test_unknown_names_are_refused_with_those_that_are_known():
    with pytest.raises(InputError, match="unknown effect 'frog'") as caught:
        choose(["fog", "frog"], SceneFacts.of(with_data("fog")), COORDINATES)
    assert all(name in str(caught.value) for name in NEEDS)


def test_a_forced_effect_is_used_whether_it_applies_or_not():
    """Noise that float32 cannot represent is not called for; if forced, it is used."""
    scene = dataclasses.replace(dry_scene(), sensor=SensorModel(range_noise_m=1e-7))
    assert called(scene) == []
    assert choose(["range_noise"], SceneFacts.of(scene), COORDINATES) == [
        Choice("range_noise", True, "requested", None)
    ]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (EffectSettings(visibility_m=40.0), ["fog"]),
        (EffectSettings(rain_mm_h=40.0), ["rain"]),
        (EffectSettings(snow_mm_h=5.0), ["snow"]),
        (EffectSettings(range_noise_m=0.02), ["range_noise"]),
        (EffectSettings(divergence_rad=3e-3), ["divergence"]),
        (EffectSettings(limit_range_m=LOST), ["ray_drop"]),
        (EffectSettings(rain_mm_h=40.0, limit_range_m=LOST), ["wet_ground", "rain", "ray_drop"]),
        (EffectSettings(object_speed_m_s=15.0), []),  # no firing times
    ],
)
def test_settings_supply_what_a_scene_does_not_state(settings, expected):
    scene = dry_scene()
    assert names(called(scene, settings=settings)) == expected
    assert names(choose(expected, SceneFacts.of(scene, settings), COORDINATES)) == expected
    assert SceneFacts.of(scene).described(settings) == SceneFacts.of(scene, settings)


def test_every_setting_is_read_by_an_effect():
    read = {name for need in NEEDS.values() for name in need.settings}
    assert read == set(EFFECT_SETTINGS), "`settings` in applicability.NEEDS"


def test_a_setting_without_a_name_of_its_own_is_refused():
    with pytest.raises(InputError, match=r"no setting hail_mm_h.*rain_mm_h"):
        EffectSettings(hail_mm_h=5.0)


def test_a_speed_of_the_object_calls_for_rolling_shutter_where_times_are_known():
    scene = dataclasses.replace(with_data("rolling_shutter"), conditions=Conditions())
    assert called(scene) == []
    assert names(called(scene, settings=EffectSettings(object_speed_m_s=15.0))) == ["rolling_shutter"]


def test_points_that_follow_the_sensor_hold_no_motion_of_it():
    scene = with_data("rolling_shutter")
    compensated = dataclasses.replace(scene, conditions=dataclasses.replace(scene.conditions, motion_compensated=True))
    assert names(choose(["rolling_shutter"], SceneFacts.of(scene), COORDINATES)) == ["rolling_shutter"]
    with pytest.raises(InputError, match="object_speed_m_s"):
        choose(["rolling_shutter"], SceneFacts.of(compensated), COORDINATES)


def test_an_effect_that_moves_no_score_is_left_out_with_the_reason(impact_file):
    measured(impact_file, range_noise=0.9 * IMPACT_BOUND, divergence=IMPACT_BOUND)
    divergence, noise = called(with_data("range_noise", "divergence"))
    assert (divergence.effect, divergence.used, divergence.milliseconds) == ("divergence", True, 2.5)
    assert (noise.effect, noise.used, noise.milliseconds) == ("range_noise", False, 2.5)
    assert noise.reason.startswith("left out") and "20 mm" in noise.reason and "0.009" in noise.reason


def test_what_was_measured_does_not_overrule_a_list(impact_file):
    measured(impact_file, range_noise=0.0)
    facts = SceneFacts.of(with_data("range_noise"))
    assert choose(["range_noise"], facts, COORDINATES) == [Choice("range_noise", True, "requested", 2.5)]


def test_what_was_measured_calls_for_nothing_by_itself(impact_file):
    measured(impact_file, **dict.fromkeys(NEEDS, 1.0))
    assert called(dry_scene(), READER) == []
