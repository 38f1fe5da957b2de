"""Files that travel with a sweep, so that a cluster's machines need no folder in common with the driver.

The driver puts them into Ray's object store, where each machine has them once and its workers map them without a copy.
A worker uses its machine's file where that has the same bytes; otherwise it writes them below
``~/.shift3d/files``, under a name made of their content, for every later worker there.

Source: our choice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic
from shift3d.task.asset_files import NamedFiles, named_files, with_files_in
from shift3d.task.exchange import AssetsSpec

ShippedFiles = Mapping[NamedFiles, Mapping[str, NDArray[np.uint8]]]
"""The bytes of files, by what names them and by name. Read-only where they come out of the object store."""


def loaded(assets: Sequence[AssetsSpec]) -> ShippedFiles:
    """Read the files that the settings of a sweep name. Raises InputError where one cannot be read."""
    every = dict.fromkeys(files for one in assets for files in named_files(one))
    return {files: {name: _read(_path(files, name)) for name in files.names} for files in every}


def unloaded(assets: AssetsSpec, shipped: ShippedFiles) -> AssetsSpec:
    """The assets with every file where this machine has it, written there now if need be.

    Raises: InputError where nothing can be written.
    """
    travelled = {files: shipped[files] for files in named_files(assets) if files in shipped}
    missing = {files: contents for files, contents in travelled.items() if not _is_here(files, contents)}
    return with_files_in(assets, {files: _written(contents) for files, contents in missing.items()})


def _path(files: NamedFiles, name: str) -> Path:
    return Path(files.folder).expanduser() / name


def _read(path: Path) -> NDArray[np.uint8]:
    try:
        return np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy="Check the path") from error


def _is_here(files: NamedFiles, contents: Mapping[str, NDArray[np.uint8]]) -> bool:
    return all(_holds(_path(files, name), content) for name, content in contents.items())


def _holds(path: Path, content: NDArray[np.uint8]) -> bool:
    """Whether a file has these bytes; one that cannot be read has not."""
    try:
        return path.stat().st_size == len(content) and np.array_equal(np.fromfile(path, np.uint8), content)
    except OSError:
        return False


def _written(contents: Mapping[str, NDArray[np.uint8]]) -> Path:
    """The folder that holds these files: its name says what is in it, so workers that write it at once agree."""
    digest = hashlib.blake2b(digest_size=16)
    for name, content in contents.items():
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content.data)
    store = Path.home() / ".shift3d" / "files"
    try:
        store.mkdir(mode=0o700, parents=True, exist_ok=True)  # what travels may be nobody else's business
    except OSError as error:
        remedy = "Give the workers a home that they can write to"
        raise InputError(f"cannot be made ({error.strerror})", where=str(store), remedy=remedy) from error
    folder = store / digest.hexdigest()
    for name, content in contents.items():
        if not _holds(folder / name, content):
            write_atomic(folder / name, content.tofile)
    return folder
