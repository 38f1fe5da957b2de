"""What is known of a scene without its points: enough to say which effects it calls for."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from shift3d.errors import InputError
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import SensorModel


@dataclass(frozen=True)
class EffectSettings:
    """What is said about scenes in place of, or beyond, what they state themselves; None: nothing.

    Attributes:
        visibility_m: fog of this meteorological optical range. rain_mm_h, snow_mm_h: rates of rain and snow.
            Weather given here is not in the points yet: it is laid over the whole scene.
        range_noise_m, divergence_rad, limit_range_m, power_spread: of the sensor, see `SensorModel`.
        object_speed_m_s: of the inserted object, along its heading.

    Source: our choice.
    """

    visibility_m: float | None = None
    rain_mm_h: float | None = None
    snow_mm_h: float | None = None
    range_noise_m: float | None = None
    divergence_rad: float | None = None
    limit_range_m: float | None = None
    power_spread: float | None = None
    object_speed_m_s: float | None = None

    def __post_init__(self) -> None:
        """Refuse what no scene can be. Raises InputError: naming the setting and the remedy."""
        for name, value in self.overrides().items():
            strictly = name in _POSITIVE
            if name == "object_speed_m_s":
                if not abs(value) <= _FASTEST_M_S:
                    raise InputError(f"{name} is {value}", "effects", f"Give {-_FASTEST_M_S:g} to {_FASTEST_M_S:g}")
            elif not np.isfinite(value) or value < 0.0 or (strictly and value == 0.0):
                remedy = "Give a positive number" if strictly else "Give a finite number of at least 0"
                raise InputError(f"{name} is {value}", "effects", remedy)
        # A scene has these bounds too, and nobody validates it again once settings describe it.
        _sensor(SensorModel(), self.overrides()).validate("effects")
        _weather(Conditions(weather_in_points=False), self.overrides(), "").validate("effects")

    def overrides(self) -> dict[str, float]:
        """The settings that are not None, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}


_FASTEST_M_S = 1e3
_POSITIVE = ("visibility_m", "range_noise_m", "divergence_rad", "limit_range_m")
_SENSOR = {part.name for part in fields(SensorModel)}


def with_settings(scene: Scene, settings: EffectSettings) -> Scene:
    """The scene as the settings describe it; the scene itself where they say nothing about it."""
    overrides = settings.overrides()
    sensor = _sensor(scene.sensor or SensorModel(), overrides)
    if sensor != (scene.sensor or SensorModel()):
        scene = replace(scene, sensor=sensor)
    conditions = _weather(scene.conditions, overrides, scene.scene_id)
    return scene if conditions == scene.conditions else replace(scene, conditions=conditions)


def _sensor(sensor: SensorModel, overrides: dict[str, float]) -> SensorModel:
    return replace(sensor, **{name: value for name, value in overrides.items() if name in _SENSOR})


def _weather(conditions: Conditions, overrides: dict[str, float], scene: str) -> Conditions:
    """A recording's own weather may be given its rate, and stays in its points; it has no other. Of a street it is the
    one that is given a rate above 0, else its own, dry where its own rate is 0."""
    about: dict[str, Any] = {name: overrides[name] for name in _WEATHER.values() if name in overrides}
    if not about:
        return conditions
    if conditions.weather_in_points and conditions.weather != "dry":
        if other := [name for name in about if name != _WEATHER[conditions.weather]]:
            what = f"its points carry {conditions.weather} already"
            raise InputError(what, f"effects, scene {scene}", f"Leave out {', '.join(other)}, or this scene")
        return replace(conditions, **about)
    stated = "dry" if _WEATHER.get(conditions.weather) in about else conditions.weather
    weather = next((word for word, name in _WEATHER.items() if about.get(name)), stated)
    return replace(conditions, weather=weather, weather_in_points=False, **about)


_WEATHER = {"snow": "snow_mm_h", "rain": "rain_mm_h", "fog": "visibility_m"}
NO_OVERRIDES = EffectSettings()
_GROUND_BAND_M = 0.3
_GROUND_SHARE = 0.02


@dataclass(frozen=True)
class DetectorFacts:
    """What an effect asks about a detector. reads_reflectance: beside coordinates."""

    name: str
    reads_reflectance: bool = False


@dataclass(frozen=True)
class SceneFacts:
    """A scene without its points.

    Attributes:
        scene_id: its name.
        origins: number of different places that beams start from (two already stand for many).
        returns: largest number of returns of a beam, as far as the scene numbers them; 1 where it does not.
        no_return_beams: beams without a return that the scene knows of.
        has_reflectance, has_pixels (range image indices): whether points carry them.
        scan_s: from the first point's firing time to the last's; 0 where times are unknown.
        ground_in_view: at least one point in fifty lies near the nominal ground.
        sensor, conditions: as the scene states them.
        object_speed_m_s: of the inserted object, along its heading.
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
        """The facts of a scene as settings describe it."""
        times = scene.time_s
        near_ground = np.abs(scene.points[:, 2] - scene.ground_z_m) < _GROUND_BAND_M
        stated = SceneFacts(
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
        )
        return stated.described(settings)

    def described(self, settings: EffectSettings) -> SceneFacts:
        """These facts as settings describe the scene: `of` with them."""
        overrides = settings.overrides()
        if not overrides:
            return self
        return replace(
            self,
            sensor=_sensor(self.sensor, overrides),
            conditions=_weather(self.conditions, overrides, self.scene_id),
            object_speed_m_s=overrides.get("object_speed_m_s", self.object_speed_m_s),
        )
