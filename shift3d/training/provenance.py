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
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic


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


def read_provenance(weights_file: Path) -> dict[str, Any] | None:
    """The facts that stand beside a weights file, or None where there are none.

    Raises: InputError naming a provenance that cannot be read.
    """
    file = weights_file.with_suffix(".json")
    if not file.is_file():
        return None
    remedy = "Restore it from a copy, or train again"
    try:
        facts = json.loads(file.read_bytes())
    except ValueError as error:
        raise InputError(f"is no provenance ({type(error).__name__})", str(file), remedy) from error
    if not isinstance(facts, dict):
        raise InputError("is no provenance (no JSON object)", str(file), remedy)
    return facts


def refuse_tuned_scenes(weights_file: Path, scenes: Mapping[str, str]) -> None:
    """Refuse to measure weights on scenes that they, or weights that they started from, were fine-tuned on.

    scenes: content hash by name; an empty hash is any. Weights without provenance, or that were trained otherwise,
    pass.
    Raises: InputError naming the scenes, or a provenance that cannot be read.
    """
    tuned: dict[str, str] = {}
    facts = read_provenance(weights_file)
    while facts:
        tuned |= (facts.get("finetuned_on") or {}).get("scenes", {})
        facts = facts.get("before")
    hashes = {value for value in tuned.values() if value}
    both = sorted(name for name, value in scenes.items() if name in tuned or value in hashes)
    if both:
        what = f"was fine-tuned on {', '.join(both[:5])}{' and others' if len(both) > 5 else ''}"
        raise InputError(what, where=str(weights_file), remedy="Measure it on scenes that it has not seen")
