"""The files that a sweep's settings name: weights, detectors and vehicles of its user's own, not those that ship."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from shift3d.task.exchange import AssetsSpec
from shift3d.vehicles.names import WIDE


@dataclass(frozen=True)
class NamedFiles:
    """Files that settings name together. folder: as they spell it. names: below it, with slashes."""

    folder: str
    names: tuple[str, ...]


def named_files(assets: AssetsSpec) -> tuple[NamedFiles, ...]:
    """What must be there to load the vehicles and detectors of a sweep, beside shift3d itself. Nothing is read.

    Scenes are not among them: a data set is too large to be sent about.
    """
    found = [_of_vehicles(assets), *map(_of_file, (*assets.detectors.values(), *assets.modules.values()))]
    return tuple(dict.fromkeys(files for files in found if files))


def with_files_in(assets: AssetsSpec, folders: Mapping[NamedFiles, Path]) -> AssetsSpec:
    """The same assets, their files in other folders. What is not in the mapping stays where it is."""
    vehicles, detectors, modules = dict(assets.vehicles), dict(assets.detectors), dict(assets.modules)
    if (files := _of_vehicles(assets)) and files in folders:
        vehicles["folder"] = str(folders[files])
    for name, path in assets.detectors.items():
        if (files := _of_file(path)) and files in folders:
            detectors[name] = str(folders[files] / files.names[0])
    for name, path in assets.modules.items():
        if (files := _of_file(path)) and files in folders:
            modules[name] = str(folders[files] / files.names[0])
    return dataclasses.replace(assets, vehicles=vehicles, detectors=detectors, modules=modules)


def _of_vehicles(assets: AssetsSpec) -> NamedFiles | None:
    folder = assets.vehicles.get("folder")
    if folder is None or (assets.vehicles["kind"] == "set" and folder == WIDE):
        return None
    # Here, because both load torch, and most sweeps name no folder.
    if assets.vehicles["kind"] == "deepsdf":
        from shift3d.sdf.foreign import experiment_file_names

        return NamedFiles(folder, experiment_file_names(assets.vehicles["checkpoint"]))
    from shift3d.vehicles.vehicle_set import DECODER_FILE, VEHICLES_FILE

    return NamedFiles(folder, (VEHICLES_FILE, DECODER_FILE))


def _of_file(path: str | None) -> NamedFiles | None:
    return None if path is None else NamedFiles(str(PurePath(path).parent), (PurePath(path).name,))
