"""Catalogue of a sweep: scenes, vehicles and weights by name, with their content hashes."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from shift3d.errors import InputError
from shift3d.processor import has_fast_bfloat16
from shift3d.settings import messages
from shift3d.settings.catalogue.compiled import compare_with_original, refuse_gradient_search
from shift3d.settings.catalogue.detector_files import (
    detector_hash,
    detector_layouts,
    require_in_range,
    scoring_detectors,
)
from shift3d.settings.catalogue.scene_entries import SceneEntry, scene_entries
from shift3d.settings.renamed import renamed_error
from shift3d.settings.schema.attack import AttackConfig
from shift3d.settings.schema.config import AccuracyConfig, Config, NaturalnessConfig
from shift3d.settings.schema.scenes import FramesConfig, scene_set
from shift3d.store.resolve import as_location

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet
    from shift3d.vehicles.sources import VehicleSource

# Precision of the detector during the search. Results are always scored in float32 or better: bfloat16 changes the
# direction of a step and no reported number. On a processor without bfloat16 instructions the plan takes float32, which
# is faster there. The plan stores the precision, so that all workers of a sweep use the same.
_SEARCH_PRECISION = {"draft": "bfloat16", "standard": "bfloat16", "paper": "float32", "reference": "float64"}


@dataclass(frozen=True)
class Catalogue:
    """Inputs of a sweep's tasks, identified by content hashes (128-bit BLAKE2b, hex).

    scene_arguments: settings that made or chose the scenes. sector_rad: (centre, half width) of the azimuths where the
    scene set allows vehicles. vehicles: name to hash, computed on access. detectors: name to hash of the scoring
    detectors, the attacked detector first. accuracy: every setting of the preset. space_hash: (vehicle, config) to the
    hash of the search space. skipped: unreadable scenes that the sweep leaves out, name to reason. reference_hash: hash
    of the source of the naturalness reference set; empty: no set. notes: lines that the plan prints.
    """

    scenes: tuple[SceneEntry, ...]
    scene_arguments: dict[str, Any]
    sector_rad: tuple[float, float]
    vehicles: Mapping[str, str]
    decoder_hash: str
    detectors: dict[str, str]
    accuracy: dict[str, Any]
    skipped: Mapping[str, str] = field(default_factory=dict)
    space_hash: Callable[[str, AttackConfig], str] = lambda vehicle, attack: ""
    reference_hash: str = ""
    notes: tuple[str, ...] = ()


def vehicle_source(values: Mapping[str, Any]) -> VehicleSource:
    """Create the vehicle source for plain settings; ``name`` is ignored. The source reads its files on first access."""
    from shift3d.vehicles.deepsdf_vehicles import DeepSdfVehicles
    from shift3d.vehicles.sources import VehicleSet

    of_source = {name: value for name, value in values.items() if name not in ("kind", "name")}
    return VehicleSet(**of_source) if values["kind"] == "set" else DeepSdfVehicles(**of_source)


def accuracy_settings(config: AccuracyConfig) -> dict[str, Any]:
    """Resolve a preset and its overrides to all settings as plain values (dtypes by name).

    ``detector`` is the precision of the detector in the search; all other settings belong to the renderer. Raises:
    InputError: an unknown or renamed setting of the renderer, or an invalid value.
    """
    from dataclasses import asdict

    import torch

    from shift3d.render.settings import preset

    settings = {
        name: str(value).removeprefix("torch.") if isinstance(value, torch.dtype) else value
        for name, value in asdict(preset(config.name)).items()
    }
    for name, value in config.render.items():
        if (renamed := renamed_error(f"accuracy.render.{name}", value)) is not None:
            raise renamed
        if name not in settings:
            raise messages.choice_error("setting", name, settings, "accuracy.render")
        if value is None:
            continue
        kind = type(settings[name]).__name__
        if type(value) is not type(settings[name]) and (type(value), kind) != (int, "float"):
            what = f"accuracy.render.{name} is {value!r}, not {kind}"
            raise InputError(what, remedy=f"Give a {kind}, as {settings[name]!r}")
        settings[name] = type(settings[name])(value)
    _check_render(settings)
    precision = config.detector or _SEARCH_PRECISION[config.name]
    if config.detector is None and precision == "bfloat16" and not has_fast_bfloat16():
        precision = "float32"
    return settings | {"detector": precision}


def _check_render(settings: dict[str, Any]) -> None:
    """Refuse settings that the renderer would refuse in every task, and infinity, which a task's id cannot hold."""
    import torch

    from shift3d.render.settings import RenderSettings

    where, remedy = "accuracy.render", "Change it with accuracy.render.NAME=VALUE"
    for name, value in settings.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{name} is {value}", where=where, remedy="Give a finite number")
    if settings["dtype"] not in ("float32", "float64"):
        raise InputError(f"dtype is {settings['dtype']!r}", where=where, remedy="Give float32 or float64")
    try:
        RenderSettings(**settings | {"dtype": getattr(torch, settings["dtype"])})
    except InputError as error:
        raise InputError(f"{error.where}: {error.what}", where=where, remedy=error.remedy or remedy) from error


def read_catalogue(config: Config, preview: bool = False) -> Catalogue:
    """Load and hash the scenes, vehicles and detectors. Raises: InputError: a missing file or an unreadable scene.

    preview: leave out hashes of scenes that would have to be generated for their hash alone, see `scene_entries`.
    """
    refuse_gradient_search(config)
    scenes = scene_set(config.scenes)
    entries, skipped = _entries(config, scenes, preview)
    source, detectors = vehicle_source(config.vehicle.model_dump()), scoring_detectors(config.detector)
    layouts, sector = detector_layouts(config.detector), scenes.placement_sector_rad
    placement = config.attack.placement
    require_in_range(layouts, sector, (placement.min_range_m, placement.max_range_m), config.shift_m)
    arguments = config.scenes.model_dump(mode="json", exclude={"root", "count", "names", "skip_bad"})
    if arguments.get("beams") is None:  # null: the street's own sensor; task ids were made without this key
        arguments.pop("beams", None)
    return Catalogue(
        scenes=entries,
        scene_arguments=arguments,
        sector_rad=sector,
        vehicles=_VehicleHashes(source),
        decoder_hash=source.decoder_hash(),
        detectors={
            name: detector_hash(name, path, config.detector.module, layouts.get(name))
            for name, path in detectors.items()
        },
        accuracy=accuracy_settings(config.accuracy),
        skipped=skipped,
        space_hash=functools.partial(_space_hash, source),
        reference_hash=_reference_hash(config.naturalness),
        notes=_notes(config, scenes, [entry.name for entry in entries], preview),
    )


def _notes(config: Config, scenes: SceneSet, names: Sequence[str], preview: bool) -> tuple[str, ...]:
    """Return notes on named scenes beyond scenes.count, and on the ONNX comparison, which a preview does not make."""
    notes = []
    wanted = config.scenes.names if isinstance(config.scenes, FramesConfig) else None
    if wanted and config.scenes.count is not None and config.scenes.count < len(wanted):
        notes.append(f"{config.scenes.count} of {len(wanted)} named scenes: scenes.count={config.scenes.count}")
    if config.detector.file is not None and not (preview and config.detector.original):
        notes.append(compare_with_original(config.detector, scenes, names))
    return tuple(notes)


def _reference_hash(config: NaturalnessConfig) -> str:
    """Hash the source of the reference set without building the set. Raises: InputError: a folder without members."""
    if (values := config.source()) is None:
        return ""
    from shift3d.naturalness.sources import reference_source, source_hash

    return source_hash(reference_source(values))


def _space_hash(source: VehicleSource, vehicle: str, attack: AttackConfig) -> str:
    """Hash the search space, see `vehicles.sources.space_hash`. Raises: InputError: the vehicles have no such space."""
    from shift3d.vehicles.sources import space_hash

    family = source.kinds() if attack.space == "family" else []
    if attack.space == "pca" or not all(source.is_parametric(name) for name in family):
        import torch

        from shift3d.attack.space import pca_space

        code = torch.from_numpy(source.vehicle(vehicle).latent_code)
        pca_space(code, source.codes(), attack.components, f"vehicle {vehicle}, attack.space={attack.space}")
    if attack.edit:
        import torch

        from shift3d.attack.space import edited_code

        code, where = torch.from_numpy(source.vehicle(vehicle).latent_code), f"vehicle {vehicle}, attack.edit"
        try:
            parameters = source.parameters(vehicle)
        except InputError as error:
            raise InputError(error.what, where, "Leave attack.edit out, or give vehicle=wide") from error
        edited_code(code, parameters, attack.edit, where)
    return space_hash(source, vehicle, attack.space, bool(attack.edit))


def _entries(config: Config, scenes: SceneSet, preview: bool) -> tuple[tuple[SceneEntry, ...], dict[str, str]]:
    """Return `scene_entries`, with file names in reasons relative to the data set's folder, equal on every machine."""
    if not isinstance(config.scenes, FramesConfig):
        return scene_entries(scenes, preview)
    entries, skipped = scene_entries(scenes, preview, config.scenes.skip_bad)
    root = re.compile(rf"(?<![\w./-]){re.escape(str(as_location(config.scenes.root)))}/")  # as error messages spell it
    return entries, {name: root.sub("", why) for name, why in skipped.items()}


class _VehicleHashes(Mapping[str, str]):
    """Lazy mapping of vehicle name to hash, because hashing a vehicle of a DeepSDF experiment decodes the vehicle.

    Iteration lists the source's names only. A vehicle drawn from a kind has a hash but is not listed.
    """

    def __init__(self, source: VehicleSource) -> None:
        self._source = source

    def __getitem__(self, name: str) -> str:
        from shift3d.vehicles.sources import vehicle_hash

        return vehicle_hash(self._source.vehicle(name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._source.names())

    def __len__(self) -> int:
        return len(self._source.names())
