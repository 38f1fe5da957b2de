"""What a machine has installed that results depend on: all machines of a sweep must have the same.

Source: our choice.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution

import shift3d
from shift3d.errors import InputError
from shift3d.sweep.planning.folder import library_versions

_LIBRARIES = ("torch", "numpy", "scipy", "trimesh", "embreex")
_NAMES = {"code": "another build of shift3d:"}


def installed() -> Mapping[str, str]:
    """Versions by name. A library's build, behind the plus sign, is left out. code: a digest of shift3d's own files,
    "" where it was not installed from a wheel."""
    libraries = {name: version.partition("+")[0] for name, version in library_versions(_LIBRARIES).items()}
    python = ".".join(platform.python_version_tuple()[:2])
    return {"shift3d": shift3d.__version__, "Python": python, **libraries, "code": _code()}


def _code() -> str:
    """By the list of files that a wheel leaves, with their hashes."""
    try:
        record = distribution("shift3d").read_text("RECORD") or ""
    except PackageNotFoundError:
        return ""
    lines = sorted(line for line in record.splitlines() if line.startswith("shift3d/") and ".py,sha256=" in line)
    return hashlib.blake2b("\n".join(lines).encode(), digest_size=4).hexdigest() if lines else ""


def difference(there: Mapping[str, str], here: Mapping[str, str]) -> InputError | None:
    """The error for a machine that has something else installed than the driver's. there, here: see `installed`."""
    found = [
        f"{_NAMES.get(name, name)} {there.get(name)}, not {value}"
        for name, value in here.items()
        if there.get(name) != value and (name != "code" or (value and there.get(name)))
    ]
    if not found:
        return None
    what = f"has {'; '.join(found)} as the driver"
    return InputError(what, remedy="Install the driver's wheel there, with the versions of its constraints.txt")
