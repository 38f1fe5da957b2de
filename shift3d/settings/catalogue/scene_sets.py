"""Scenes that settings describe."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.settings.schema.scenes import (
    Argoverse2Config,
    KittiConfig,
    NuScenesConfig,
    SceneConfig,
    StreetConfig,
    WaymoConfig,
)

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet

__all__ = ["scene_set"]


def scene_set(config: SceneConfig) -> SceneSet:
    """The scenes that settings describe. Readers are imported when their data set is asked for.

    Raises:
        InputError: a missing or unreadable folder.
    """
    if isinstance(config, StreetConfig):
        from shift3d.scenes.sets import StreetScenes

        return StreetScenes(config.sensor, config.seed, config.count, config.split, options=config.options())
    if isinstance(config, KittiConfig):
        return _kitti(config)
    root, names, count, keep_bad = config.root, config.names, config.count, config.skip_bad
    if isinstance(config, WaymoConfig):
        from shift3d.scenes.waymo.scenes import WaymoScenes

        return WaymoScenes(root, names, count, config.lasers, config.every, keep_bad)
    if isinstance(config, Argoverse2Config):
        from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes

        return Argoverse2Scenes(root, names, count, config.every)
    if isinstance(config, NuScenesConfig):
        from shift3d.scenes.nuscenes.scenes import NuScenesScenes

        return NuScenesScenes(root, names, count, config.version, config.sweeps, keep_bad)
    from shift3d.scenes.openpcdet import OpenPcdetScenes

    x, y, z = config.sensor_m
    constants = (config.ground_z_m, config.reflectance_max)
    return OpenPcdetScenes(root, names, count, config.split, (x, y, z), *constants, keep_bad)


def _kitti(config: KittiConfig) -> SceneSet:
    from shift3d.scenes.kitti.scenes import KittiScenes

    scenes = KittiScenes(config.root, config.names, config.reflectance_max, config.skip_bad)
    if config.count is None:
        return scenes
    return KittiScenes(config.root, scenes.names()[: config.count], config.reflectance_max, config.skip_bad)
