"""Where sweeps, configuration and launch specs are found: in the folder where the command runs, then among those that
ship.

``sweeps/``, ``conf/`` and ``jobs/`` stand at the top of a checkout. A wheel carries them inside the package (setup.py
says how). A team's own files lie in folders of the same names where the command runs; a file there takes the place of
one of its name that ships.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from shift3d.errors import InputError


def shipped(path: str) -> Path:
    """A folder that ships. path: ``sweeps``, ``jobs``, ``conf`` or below. Raises InputError where it is missing."""
    package = Path(__file__).resolve().parents[1]
    carried = package / "_data"
    root = carried if carried.is_dir() else package.parent
    if not (root / path).is_dir() and "/" not in path:
        remedy = "Install shift3d from its wheel, or from a whole checkout: make setup"
        raise InputError(f"the folder {path}/ is missing", where=str(root), remedy=remedy)
    return root / path


def places(path: str) -> list[Path]:
    """Folders in which a file is looked for, the first wins. They need not exist. Raises as :func:`shipped`."""
    own, theirs = Path(path), shipped(path)
    return [theirs] if own.is_dir() and theirs.is_dir() and own.samefile(theirs) else [own, theirs]


def files(path: str, pattern: str = "[!_]*.yaml") -> dict[str, Path]:
    """Files of :func:`places` by their names without the ending, sorted. Raises as :func:`shipped`."""
    found = {file.stem: file for folder in reversed(places(path)) for file in folder.glob(pattern) if file.is_file()}
    return dict(sorted(found.items()))


def own_folders() -> list[Path]:
    """The folders of sweeps and of groups where the command runs, as far as they are there and not those that ship."""
    return [folders[0] for folders in map(places, ("sweeps", "conf")) if len(folders) > 1 and folders[0].is_dir()]


def looked_in(path: str) -> str:
    """``Looked in sweeps and /usr/lib/.../sweeps``, for an error. Raises as :func:`shipped`."""
    return f"Looked in {' and '.join(map(shown, places(path)))}"


def shown(path: Path) -> str:
    """A path as a reader types it: what lies below the current folder without what leads there."""
    with contextlib.suppress(FileNotFoundError):  # the current folder was removed
        path = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
    return str(path) if path.is_absolute() else f"./{path}"
