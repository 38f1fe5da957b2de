"""The packages of the extra ``onnx``, asked for before they are needed."""

from __future__ import annotations

import importlib.util

from shift3d.errors import InputError


def require_packages(*names: str) -> None:
    """Raises InputError with the command that installs them, where a package is missing."""
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise InputError(f"the package {name} is not installed", "detector=onnx", "pip install 'shift3d[onnx]'")
