"""Folders of sweeps, configuration and launch specs: those of the current folder, then the shipped ones.

``sweeps/``, ``conf/`` and ``jobs/`` are top-level folders of a checkout; a wheel contains them inside the package (see
setup.py). A file in a folder of these names in the current folder replaces the shipped file of the same name.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from shift3d.errors import InputError


def shipped(path: str) -> Path:
    """Return a shipped folder. path: ``sweeps``, ``jobs``, ``conf`` or below. Raises: InputError: missing folder."""
    package = Path(__file__).resolve().parents[1]
    carried = package / "_data"
    root = carried if carried.is_dir() else package.parent
    if not (root / path).is_dir() and "/" not in path:
        remedy = "Install shift3d from its wheel, or from a whole checkout: make setup"
        raise InputError(f"the folder {path}/ is missing", where=str(root), remedy=remedy)
    return root / path


def places(path: str) -> list[Path]:
    """Return the folders to search, highest priority first; they need not exist. Raises as :func:`shipped`."""
    own, theirs = Path(path), shipped(path)
    return [theirs] if own.is_dir() and theirs.is_dir() and own.samefile(theirs) else [own, theirs]


def files(path: str, pattern: str = "[!_]*.yaml") -> dict[str, Path]:
    """List the files of :func:`places` by stem, sorted. Raises as :func:`shipped`."""
    found = {file.stem: file for folder in reversed(places(path)) for file in folder.glob(pattern) if file.is_file()}
    return dict(sorted(found.items()))


def own_folders() -> list[Path]:
    """List ``sweeps`` and ``conf`` of the current folder that exist and are not the shipped folders."""
    return [folders[0] for folders in map(places, ("sweeps", "conf")) if len(folders) > 1 and folders[0].is_dir()]


def searched_folders_text(path: str) -> str:
    """Format the searched folders for an error: ``Looked in sweeps and /usr/...``. Raises as :func:`shipped`."""
    return f"Looked in {' and '.join(map(shown, places(path)))}"


def shown(path: Path) -> str:
    """Format a path as a user types it: relative to the current folder for paths below it, else absolute."""
    with contextlib.suppress(FileNotFoundError):  # the current folder was removed
        path = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
    return str(path) if path.is_absolute() else f"./{path}"
