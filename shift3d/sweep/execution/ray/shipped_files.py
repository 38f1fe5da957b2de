"""Files shipped with a sweep, so that a cluster's machines need no folder in common with the driver.

The driver puts the files into Ray's object store, which holds them once per machine; workers map them without a copy. A
worker uses its machine's file if that has the same bytes; otherwise it writes the shipped file below
``~/.shift3d/files``, under a digest of the content, for all later workers on the machine.

Source: our choice.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic
from shift3d.task.exchange import AssetsSpec
from shift3d.vehicles.sources import WIDE


@dataclass(frozen=True)
class NamedFiles:
    """Files that settings name together. folder: as spelled there. names: relative to folder, with slashes."""

    folder: str
    names: tuple[str, ...]


ShippedFiles = Mapping[NamedFiles, Mapping[str, NDArray[np.uint8]]]
"""Bytes of files, by `NamedFiles` and by name. Read-only if they come from the object store."""


def read_shipped_files(assets: Sequence[AssetsSpec]) -> ShippedFiles:
    """Read the files that the settings of a sweep name. Raises InputError if one cannot be read."""
    every = dict.fromkeys(files for one in assets for files in named_files(one))
    return {files: {name: _read(_path(files, name)) for name in files.names} for files in every}


def with_local_files(assets: AssetsSpec, shipped: ShippedFiles) -> AssetsSpec:
    """Return the assets with paths to files of this machine; missing files are written.

    Raises: InputError: a file cannot be written.
    """
    travelled = {files: shipped[files] for files in named_files(assets) if files in shipped}
    missing = {
        files: contents
        for files, contents in travelled.items()
        if not all(_holds(_path(files, name), content) for name, content in contents.items())
    }
    return with_files_in(assets, {files: _written(contents) for files, contents in missing.items()})


def _path(files: NamedFiles, name: str) -> Path:
    return Path(files.folder).expanduser() / name


def _read(path: Path) -> NDArray[np.uint8]:
    try:
        return np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy="Check the path") from error


def _holds(path: Path, content: NDArray[np.uint8]) -> bool:
    """True if the file has these bytes; False if it cannot be read."""
    try:
        return path.stat().st_size == len(content) and np.array_equal(np.fromfile(path, np.uint8), content)
    except OSError:
        return False


def _written(contents: Mapping[str, NDArray[np.uint8]]) -> Path:
    """Write files, and return their folder. Its name is a digest of the content, so concurrent workers agree on it."""
    digest = hashlib.blake2b(digest_size=16)
    for name, content in contents.items():
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content.data)
    store = Path.home() / ".shift3d" / "files"
    try:
        store.mkdir(mode=0o700, parents=True, exist_ok=True)  # shipped files may be private
    except OSError as error:
        remedy = "Give the workers a home that they can write to"
        raise InputError(f"cannot be made ({error.strerror})", where=str(store), remedy=remedy) from error
    folder = store / digest.hexdigest()
    for name, content in contents.items():
        if not _holds(folder / name, content):
            write_atomic(folder / name, content.tofile)
    return folder


def named_files(assets: AssetsSpec) -> tuple[NamedFiles, ...]:
    """Return the files, beside shift3d itself, that loading the vehicles and detectors needs. Nothing is read.

    Scenes are excluded: a data set is too large to ship.
    """
    found = [_of_vehicles(assets), *map(_of_file, (*assets.detectors.values(), *assets.modules.values()))]
    return tuple(dict.fromkeys(files for files in found if files))


def with_files_in(assets: AssetsSpec, folders: Mapping[NamedFiles, Path]) -> AssetsSpec:
    """Return the assets with files in other folders. Files that are not in the mapping keep their folder."""
    vehicles, detectors = dict(assets.vehicles), dict(assets.detectors)
    modules: dict[str, Any] = dict(assets.modules)
    if (files := _of_vehicles(assets)) and files in folders:
        vehicles["folder"] = str(folders[files])
    for paths in (detectors, modules):
        for name, path in paths.items():
            if (files := _of_file(path)) and files in folders:
                paths[name] = str(folders[files] / files.names[0])
    return dataclasses.replace(assets, vehicles=vehicles, detectors=detectors, modules=modules)


def _of_vehicles(assets: AssetsSpec) -> NamedFiles | None:
    folder = assets.vehicles.get("folder")
    if folder is None or (assets.vehicles["kind"] == "set" and folder == WIDE):
        return None
    # Late imports: both modules load torch, and most sweeps name no folder.
    if assets.vehicles["kind"] == "deepsdf":
        from shift3d.sdf.deepsdf_checkpoint import experiment_file_names

        return NamedFiles(folder, experiment_file_names(assets.vehicles["checkpoint"]))
    from shift3d.vehicles.vehicle_set import DECODER_FILE, VEHICLES_FILE

    return NamedFiles(folder, (VEHICLES_FILE, DECODER_FILE))


def _of_file(path: str | None) -> NamedFiles | None:
    return None if path is None else NamedFiles(str(PurePath(path).parent), (PurePath(path).name,))
