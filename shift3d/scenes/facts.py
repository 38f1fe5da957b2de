"""What is known of a scene without its points: enough to say which effects it calls for."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from shift3d.scenes.labels import Conditions
from shift3d.scenes.scene import Scene
from shift3d.scenes.sensor import SensorModel

__all__ = ["EffectSettings", "SceneFacts", "with_settings"]


@dataclass(frozen=True)
class EffectSettings:
    """What is said about scenes in place of, or beyond, what they state themselves; None: nothing.

    Attributes:
        visibility_m: fog of this meteorological optical range. rain_mm_h, snow_mm_h: rates of rain and snow.
            Weather given here is not in the points yet: it is laid over the whole scene.
        range_noise_m, divergence_rad, limit_range_m: of the sensor, see `SensorModel`.
        object_speed_m_s: of the inserted object, along its heading.

    Source: our choice.
    """

    visibility_m: float | None = None
    rain_mm_h: float | None = None
    snow_mm_h: float | None = None
    range_noise_m: float | None = None
    divergence_rad: float | None = None
    limit_range_m: float | None = None
    object_speed_m_s: float | None = None

    def given(self) -> dict[str, float]:
        """The settings that are not None, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}


NOTHING_SAID = EffectSettings()
_SENSOR = {field.name for field in fields(SensorModel)}


def with_settings(scene: Scene, settings: EffectSettings) -> Scene:
    """The scene as the settings describe it; the scene itself where they say nothing about it."""
    given = settings.given()
    about_sensor = {name: value for name, value in given.items() if name in _SENSOR}
    if about_sensor:
        scene = replace(scene, sensor=replace(scene.sensor or SensorModel(), **about_sensor))
    conditions = _weather(scene.conditions, given)
    return scene if conditions == scene.conditions else replace(scene, conditions=conditions)


def _weather(conditions: Conditions, given: dict[str, float]) -> Conditions:
    about: dict[str, Any] = {name: given[name] for name in _WEATHER.values() if name in given}
    if not about:
        return conditions
    weather = next((word for word, name in _WEATHER.items() if about.get(name)), "dry")
    return replace(conditions, weather=weather, weather_in_points=False, **about)


_WEATHER = {"snow": "snow_mm_h", "rain": "rain_mm_h", "fog": "visibility_m"}
_GROUND_BAND_M = 0.3
_GROUND_SHARE = 0.02


@dataclass(frozen=True)
class SceneFacts:
    """A scene without its points.

    Attributes:
        scene_id: its name.
        origins: number of different places that beams start from (two already stand for many).
        returns: largest number of returns of a beam, as far as the scene numbers them; 1 where it does not.
        silent_beams: beams without a return that the scene knows of.
        has_reflectance, has_pixels (range image indices): whether points carry them.
        scan_s: from the first point's firing time to the last's; 0 where times are unknown.
        ground_in_view: at least one point in fifty lies near the nominal ground.
        sensor, conditions: as the scene states them.
        object_speed_m_s: of the inserted object, along its heading.
    """

    scene_id: str
    origins: int
    returns: int
    silent_beams: int
    has_reflectance: bool
    has_pixels: bool
    scan_s: float
    ground_in_view: bool
    sensor: SensorModel
    conditions: Conditions
    object_speed_m_s: float = 0.0

    @staticmethod
    def of(scene: Scene, settings: EffectSettings = NOTHING_SAID) -> SceneFacts:
        """The facts of a scene as settings describe it."""
        scene = with_settings(scene, settings)
        times = scene.time_s
        near_ground = np.abs(scene.points[:, 2] - scene.ground_z_m) < _GROUND_BAND_M
        return SceneFacts(
            scene_id=scene.scene_id,
            origins=1 if bool((scene.origins == scene.origins[:1]).all()) else 2,
            returns=1 if scene.return_number is None else int(scene.return_number.max(initial=0)) + 1,
            silent_beams=0 if scene.silent is None else len(scene.silent),
            has_reflectance=scene.reflectance is not None,
            has_pixels=scene.range_image_index is not None,
            scan_s=0.0 if times is None else float(times.max() - times.min()),
            ground_in_view=bool(near_ground.mean() > _GROUND_SHARE),
            sensor=scene.sensor or SensorModel(),
            conditions=scene.conditions,
            object_speed_m_s=settings.object_speed_m_s or 0.0,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)
