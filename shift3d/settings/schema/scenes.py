"""Settings of the group ``scenes``, and constructors of their scene sets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, TypeAdapter, model_validator

from shift3d.errors import InputError
from shift3d.scenes.reflectance import MOST_RAW
from shift3d.scenes.street.options import BEAM_NAMES, LIMITS, MOST_SENSORS, StreetOptions
from shift3d.settings.names import Name, Text
from shift3d.settings.schema.records import Count, Record, Seed

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet


Metres = Annotated[float, Field(ge=-1e3, le=1e3, allow_inf_nan=False)]

if TYPE_CHECKING:
    BeamName = str
else:
    BeamName = Literal[*BEAM_NAMES]


class StreetOptionsConfig(Record):
    """Options of street scenes beyond one return per beam, see `scenes.street.options`. All are off by default."""

    weather: Literal["dry", "rain", "fog", "snow"] = "dry"
    rain_mm_h: Annotated[float, Field(gt=0, le=LIMITS["rain_mm_h"])] | None = None
    visibility_m: Annotated[float, Field(gt=0, le=LIMITS["visibility_m"])] | None = None
    snow_mm_h: Annotated[float, Field(gt=0, le=LIMITS["snow_mm_h"])] | None = None
    sensor_model: bool = False
    range_image: bool = False
    returns: Literal[1, 2] = 1
    sensors: Annotated[int, Field(ge=1, le=MOST_SENSORS)] = 1
    ego_speed_m_s: Annotated[float, Field(ge=0, le=LIMITS["ego_speed_m_s"])] = 0.0
    motion_compensated: bool = False
    traffic: Literal["family", "wide", "held_out"] = "family"
    beams: BeamName | None = None

    def options(self) -> StreetOptions:
        """Return the options for the street generator. Raises: InputError: contradictory settings."""
        return StreetOptions(**{name: getattr(self, name) for name in StreetOptionsConfig.model_fields})

    @model_validator(mode="after")
    def _without_contradiction(self) -> Self:
        try:
            self.options()
        except InputError as error:
            raise ValueError(error.what, error.remedy) from error
        return self


class StreetConfig(StreetOptionsConfig):
    """Procedural street scenes."""

    kind: Literal["street"]
    sensor: Literal["hdl64", "waymo_top", "mixed"]
    split: Literal["train", "val", "test"]
    seed: Seed
    count: Count


class FramesConfig(Record):
    """Recorded frames under ``root``, a folder or bucket. names: frames to use; None: all. count: number of frames from
    the first. skip_bad: leave out unreadable frames."""

    kind: str
    root: Text
    count: Count | None
    names: list[Name] | None
    skip_bad: bool = False


class KittiConfig(FramesConfig):
    """KITTI object frames under ``root``/training. reflectance_max: value of full reflectance in the files; None: 1."""

    kind: Literal["kitti"]
    reflectance_max: Annotated[float, Field(gt=0, le=MOST_RAW)] | None = None


class WaymoConfig(FramesConfig):
    """Frames of the Waymo Open Dataset, version 2, see `scenes.waymo.scenes`."""

    kind: Literal["waymo"]
    lasers: Annotated[list[Literal["TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"]], Field(min_length=1)]
    every: Count


class Argoverse2Config(FramesConfig):
    """Sweeps of Argoverse 2, see `scenes.argoverse2.scenes`."""

    kind: Literal["argoverse2"]
    every: Count


class NuScenesConfig(FramesConfig):
    """Key frames of nuScenes, see `scenes.nuscenes.scenes`."""

    kind: Literal["nuscenes"]
    version: Text | None
    sweeps: Annotated[int, Field(ge=1, le=100)]


class OpenPcdetConfig(FramesConfig):
    """Frames in OpenPCDet's layout for custom data, see `scenes.openpcdet`."""

    kind: Literal["openpcdet"]
    split: Text | None
    sensor_m: Annotated[list[Metres], Field(min_length=3, max_length=3)]
    ground_z_m: Metres | None
    reflectance_max: Annotated[float, Field(gt=0, le=MOST_RAW)] | None


SceneConfig = StreetConfig | KittiConfig | WaymoConfig | Argoverse2Config | NuScenesConfig | OpenPcdetConfig


def scene_config(values: Mapping[str, Any]) -> SceneConfig:
    """Parse plain values to scene settings by their ``kind``. Raises: ValidationError: invalid values."""
    return TypeAdapter[SceneConfig](Annotated[SceneConfig, Field(discriminator="kind")]).validate_python(dict(values))


def scene_set(config: SceneConfig) -> SceneSet:
    """Create the scene set of settings, with lazy imports. Raises: InputError: a missing or unreadable folder."""
    if isinstance(config, StreetConfig):
        from shift3d.scenes.sets import StreetScenes

        return StreetScenes(config.sensor, config.seed, config.count, config.split, options=config.options())
    root, names, count, list_unreadable = config.root, config.names, config.count, config.skip_bad
    if isinstance(config, KittiConfig):
        from shift3d.scenes.kitti.scenes import KittiScenes

        return KittiScenes(root, names, count, config.reflectance_max, list_unreadable)
    if isinstance(config, WaymoConfig):
        from shift3d.scenes.waymo.scenes import WaymoScenes

        return WaymoScenes(root, names, count, config.lasers, config.every, list_unreadable)
    if isinstance(config, Argoverse2Config):
        from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes

        return Argoverse2Scenes(root, names, count, config.every, list_unreadable)
    if isinstance(config, NuScenesConfig):
        from shift3d.scenes.nuscenes.scenes import NuScenesScenes

        return NuScenesScenes(root, names, count, config.version, config.sweeps, list_unreadable)
    from shift3d.scenes.openpcdet import OpenPcdetScenes

    x, y, z = config.sensor_m
    constants = (config.ground_z_m, config.reflectance_max)
    return OpenPcdetScenes(root, names, count, config.split, (x, y, z), *constants, list_unreadable)
