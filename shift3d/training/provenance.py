"""What stands beside trained weights: how they came about, in words that another run can follow."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from shift3d import __version__
from shift3d.store.atomic import write_atomic

__all__ = ["versions", "write_provenance"]


def versions() -> dict[str, str]:
    """Versions of what computes."""
    return {
        "shift3d": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
    }


def write_provenance(weights_file: Path, facts: Mapping[str, Any]) -> Path:
    """Write facts and versions as JSON beside a weights file, in one step; returns the file.

    Raises: InputError when the disk is full or not writable.
    """
    file = weights_file.with_suffix(".json")
    text = json.dumps({**facts, "versions": versions()}, indent=1, default=str) + "\n"
    write_atomic(file, text.encode())
    return file
