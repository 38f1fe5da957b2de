"""Facts of a scene without its points, enough to decide which effects it calls for."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from shift3d.errors import InputError
from shift3d.scenes.scene import FASTEST_M_S, WEATHER_FIELDS, Conditions, Scene
from shift3d.scenes.sensor import SensorModel

EFFECT_SETTINGS = (
    *WEATHER_FIELDS.values(),
    *(part.name for part in fields(SensorModel)),
    "object_speed_m_s",
)
"""Names of `EffectSettings`: strengths of weathers, facts of the sensor, speed of the object along its heading."""


class EffectSettings:
    """Settings that replace or complete what scenes state, by the names in `EFFECT_SETTINGS`; None: no change.

    Their meanings are those of `Conditions` and `SensorModel`. The effects apply this weather to the whole scene, whose
    points do not contain it yet.

    Raises InputError: an unknown name, or a value that no scene can have, naming the setting and the remedy.
    Source: our choice.
    """

    def __init__(self, **values: float | None) -> None:
        self._overrides = {name: value for name, value in values.items() if value is not None}
        if unknown := sorted(self._overrides.keys() - set(EFFECT_SETTINGS)):
            raise InputError(f"no setting {unknown[0]}", "effects", f"Choose from {', '.join(EFFECT_SETTINGS)}")
        if not abs(self.object_speed_m_s) <= FASTEST_M_S:
            what = f"object_speed_m_s is {self.object_speed_m_s}"
            raise InputError(what, "effects", f"Give {-FASTEST_M_S:g} to {FASTEST_M_S:g}")
        # A scene has these bounds too; after the settings are applied it is not validated a second time.
        _sensor(SensorModel(), self._overrides).validate("effects")
        _weather(Conditions(weather_in_points=False), self._overrides, "").validate("effects")

    @property
    def object_speed_m_s(self) -> float:
        """Speed of the inserted object along its heading; 0 if it is not set."""
        return self._overrides.get("object_speed_m_s", 0.0)

    def overrides(self) -> dict[str, float]:
        """Return the settings that are not None, by name."""
        return dict(self._overrides)


_SENSOR = {part.name for part in fields(SensorModel)}


def with_settings(scene: Scene, settings: EffectSettings) -> Scene:
    """Return the scene with the settings applied; the same scene if they change nothing."""
    overrides = settings.overrides()
    sensor = _sensor(scene.sensor or SensorModel(), overrides)
    if sensor != (scene.sensor or SensorModel()):
        scene = replace(scene, sensor=sensor)
    conditions = _weather(scene.conditions, overrides, scene.scene_id)
    return scene if conditions == scene.conditions else replace(scene, conditions=conditions)


def _sensor(sensor: SensorModel, overrides: dict[str, float]) -> SensorModel:
    return replace(sensor, **{name: value for name, value in overrides.items() if name in _SENSOR})


def _weather(conditions: Conditions, overrides: dict[str, float], scene: str) -> Conditions:
    """Apply weather settings. A recording with weather in its points accepts only that weather's rate and keeps it in
    the points. Other scenes get the weather with a rate above 0, else their own, or dry if that rate is set to 0."""
    about: dict[str, Any] = {name: overrides[name] for name in WEATHER_FIELDS.values() if name in overrides}
    if not about:
        return conditions
    if conditions.weather_in_points and conditions.weather != "dry":
        if other := [name for name in about if name != WEATHER_FIELDS[conditions.weather]]:
            what = f"its points carry {conditions.weather} already"
            raise InputError(what, f"effects, scene {scene}", f"Leave out {', '.join(other)}, or this scene")
        return replace(conditions, **about)
    stated = "dry" if WEATHER_FIELDS.get(conditions.weather) in about else conditions.weather
    weather = next((word for word, name in reversed(WEATHER_FIELDS.items()) if about.get(name)), stated)
    return replace(conditions, weather=weather, weather_in_points=False, **about)


NO_OVERRIDES = EffectSettings()
_GROUND_BAND_M = 0.3
_GROUND_SHARE = 0.02


@dataclass(frozen=True)
class DetectorFacts:
    """Facts of a detector that effects ask for. reads_reflectance: reads reflectance beside coordinates."""

    name: str
    reads_reflectance: bool = False


@dataclass(frozen=True)
class SceneFacts:
    """Facts of a scene without its points.

    Attributes:
        scene_id: name of the scene.
        origins: number of different beam origins (2 stands for any larger number).
        returns: largest number of returns of a beam; 1 if the scene does not number them.
        no_return_beams: number of no-return beams that the scene knows.
        has_reflectance, has_pixels: the points have reflectance, range image indices.
        scan_s: time from the first to the last firing; 0 if times are unknown.
        ground_in_view: at least one point in fifty lies near the nominal ground.
        sensor, conditions: as the scene states them.
        object_speed_m_s: speed of the inserted object along its heading.
    """

    scene_id: str
    origins: int = 1
    returns: int = 1
    no_return_beams: int = 0
    has_reflectance: bool = False
    has_pixels: bool = False
    scan_s: float = 0.0
    ground_in_view: bool = True
    sensor: SensorModel = field(default_factory=SensorModel)
    conditions: Conditions = field(default_factory=Conditions)
    object_speed_m_s: float = 0.0

    @staticmethod
    def of(scene: Scene, settings: EffectSettings = NO_OVERRIDES) -> SceneFacts:
        """Collect the facts of a scene with the settings applied."""
        times = scene.time_s
        near_ground = np.abs(scene.points[:, 2] - scene.ground_z_m) < _GROUND_BAND_M
        return SceneFacts(
            scene_id=scene.scene_id,
            origins=1 if bool((scene.origins == scene.origins[:1]).all()) else 2,
            returns=1 if scene.return_number is None else int(scene.return_number.max(initial=0)) + 1,
            no_return_beams=0 if scene.no_return is None else len(scene.no_return),
            has_reflectance=scene.reflectance is not None,
            has_pixels=scene.range_image_index is not None,
            scan_s=0.0 if times is None else float(times.max() - times.min()),
            ground_in_view=bool(near_ground.mean() > _GROUND_SHARE),
            sensor=scene.sensor or SensorModel(),
            conditions=scene.conditions,
        ).described(settings)

    def described(self, settings: EffectSettings) -> SceneFacts:
        """Return these facts with the settings applied, equal to `of` with the settings."""
        overrides = settings.overrides()
        return replace(
            self,
            sensor=_sensor(self.sensor, overrides),
            conditions=_weather(self.conditions, overrides, self.scene_id),
            object_speed_m_s=overrides.get("object_speed_m_s", self.object_speed_m_s),
        )
