"""Installed versions that results depend on: all machines of a sweep must have the same.

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

_LIBRARIES = ("torch", "numpy", "scipy", "trimesh", "embreex", "onnxruntime")
_NAMES = {"code": "another build of shift3d:"}
_OPTIONAL = {"code": "", "onnxruntime": "absent"}
"""Parts that a machine may lack, with their version there. ONNX Runtime scores ONNX files; loading one without it is an
error of its own."""


def installed_versions() -> Mapping[str, str]:
    """Return the versions by name, without the build of a library (after the plus sign). code: digest of shift3d's own
    files; "" without installation from a wheel."""
    libraries = {name: version.partition("+")[0] for name, version in library_versions(_LIBRARIES).items()}
    python = ".".join(platform.python_version_tuple()[:2])
    return {"shift3d": shift3d.__version__, "Python": python, **libraries, "code": _code()}


def _code() -> str:
    """Return a digest of the list of files and hashes that a wheel installs."""
    try:
        record = distribution("shift3d").read_text("RECORD") or ""
    except PackageNotFoundError:
        return ""
    lines = sorted(line for line in record.splitlines() if line.startswith("shift3d/") and ".py,sha256=" in line)
    return hashlib.blake2b("\n".join(lines).encode(), digest_size=4).hexdigest() if lines else ""


def version_mismatch(there: Mapping[str, str], here: Mapping[str, str]) -> InputError | None:
    """Return the error for a machine whose versions differ, or None. there, here: versions by name."""
    found = [
        f"{_NAMES.get(name, name)} {there.get(name)}, not {value}"
        for name, value in here.items()
        if there.get(name) != value and not (name in _OPTIONAL and _OPTIONAL[name] in (value, there.get(name)))
    ]
    if not found:
        return None
    what = f"has {'; '.join(found)} as the driver"
    return InputError(what, remedy="Install the driver's wheel there, with the versions of its constraints.txt")
