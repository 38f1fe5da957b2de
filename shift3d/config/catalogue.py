"""What there is to run on: scenes, vehicles and weights by name, with the hashes of their content."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.config import messages
from shift3d.config.schema import AccuracyConfig, Config, KittiConfig, StreetConfig
from shift3d.errors import InputError
from shift3d.processor import has_fast_bfloat16

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet

__all__ = ["Catalogue", "SceneEntry", "accuracy_settings", "read_catalogue", "scene_set", "weights_file"]


# Precision of the detector while it is descended; what was found is scored in float32 or better whatever this
# says. bfloat16 changes the direction of a step and nothing that is reported. A processor without instructions for
# it plans with float32, which is faster there; the plan says which, so that all workers of a sweep do the same.
_SEARCH_PRECISION = {"draft": "bfloat16", "standard": "bfloat16", "paper": "float32", "reference": "float64"}


@dataclass(frozen=True)
class SceneEntry:
    """One scene: its name in the set, its data set, and the hash of its content."""

    name: str
    dataset: str
    content_hash: str


@dataclass(frozen=True)
class Catalogue:
    """What a sweep's tasks refer to, by content.

    scene_arguments: how the scenes were made or chosen. sector_rad: (centre, half width) of the azimuths in
    which the scene set lets vehicles be placed. vehicles: name to hash. Hashes are 128-bit BLAKE2b, hex.
    accuracy: every setting behind a preset's name.
    """

    scenes: tuple[SceneEntry, ...]
    scene_arguments: dict[str, Any]
    sector_rad: tuple[float, float]
    vehicles: dict[str, str]
    decoder_hash: str
    detector_hash: str
    accuracy: dict[str, Any]


def scene_set(config: StreetConfig | KittiConfig) -> SceneSet:
    """The scenes that settings describe. Raises InputError for a missing or unreadable folder."""
    if isinstance(config, StreetConfig):
        from shift3d.scenes.sets import StreetScenes

        return StreetScenes(sensor=config.sensor, seed=config.seed, count=config.count, split=config.split)
    from shift3d.scenes.kitti import KittiScenes

    scenes = KittiScenes(Path(config.root).expanduser(), names=config.names)
    if config.count is None:
        return scenes
    return KittiScenes(Path(config.root).expanduser(), names=scenes.names()[: config.count])


def weights_file(name: str, override: str | None) -> Path:
    """A file of weights: the one given, or the one that ships. Raises InputError where it is missing."""
    path = Path(override) if override else Path(__file__).resolve().parents[1] / "weights" / name
    if not path.is_file():
        remedy = "Check the path" if override else "Fetch it with the repository, or train it: make train"
        raise InputError("weights file not found", where=str(path), remedy=remedy)
    return path


def accuracy_settings(config: AccuracyConfig) -> dict[str, Any]:
    """Every setting behind a preset, with its changes, as plain values (dtypes by name).

    ``detector`` is the precision of the detector inside the search, the others are the renderer's.
    """
    from dataclasses import asdict

    import torch

    from shift3d.render.settings import preset

    settings = {
        name: str(value).removeprefix("torch.") if isinstance(value, torch.dtype) else value
        for name, value in asdict(preset(config.name)).items()
    }
    for name, value in config.render.items():
        if name not in settings:
            raise messages.choice_error("setting", name, settings, "accuracy.render")
        if value is None:
            continue
        if type(value) is not type(settings[name]) and not (
            isinstance(value, int) and isinstance(settings[name], float) and not isinstance(value, bool)
        ):
            kind = type(settings[name]).__name__
            raise InputError(
                f"accuracy.render.{name} is {value!r}, not {kind}",
                remedy=f"Give a {kind}, as {settings[name]!r}",
            )
        settings[name] = type(settings[name])(value)
    precision = config.detector or _SEARCH_PRECISION[config.name]
    if config.detector is None and precision == "bfloat16" and not has_fast_bfloat16():
        precision = "float32"
    return settings | {"detector": precision}


def read_catalogue(config: Config) -> Catalogue:
    """Load what tasks of these settings refer to, and hash it.

    Raises:
        InputError: a missing file, or a scene that cannot be read.
    """
    scenes = scene_set(config.scenes)
    entries = []
    for name in scenes.names():
        scene = scenes.load(name)
        entries.append(SceneEntry(name, scene.dataset, scene.content_hash()))
    arguments = config.scenes.model_dump(mode="json", exclude={"root", "count", "names"})
    return Catalogue(
        scenes=tuple(entries),
        scene_arguments=arguments,
        sector_rad=(float(scenes.placement_sector_rad[0]), float(scenes.placement_sector_rad[1])),
        vehicles=_vehicle_hashes(),
        decoder_hash=_file_hash(weights_file("sdf.safetensors", config.vehicle.decoder_weights)),
        detector_hash=_file_hash(weights_file(f"{config.detector.name}.safetensors", config.detector.weights)),
        accuracy=accuracy_settings(config.accuracy),
    )


def _vehicle_hashes() -> dict[str, str]:
    import numpy as np

    from shift3d.vehicles.vehicle import baseline_vehicles

    hashes = {}
    for name, vehicle in baseline_vehicles().items():
        digest = hashlib.blake2b(json.dumps([name, float(vehicle.scale_m)]).encode(), digest_size=16)
        for array in (vehicle.latent_code, vehicle.sdf_R_object, vehicle.sdf_t_object, vehicle.size_m):
            digest.update(np.asarray(array, dtype=np.float64).tobytes())
        hashes[name] = digest.hexdigest()
    return hashes


def _file_hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
