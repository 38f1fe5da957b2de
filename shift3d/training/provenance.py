"""Provenance file beside trained weights: the facts that another run needs to repeat the training."""

from __future__ import annotations

import json
import platform
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from shift3d import __version__
from shift3d.errors import InputError
from shift3d.scenes.sets import independent_group_of
from shift3d.store.atomic import write_atomic


def versions() -> dict[str, str]:
    """Return the versions of shift3d, Python, torch and numpy."""
    return {
        "shift3d": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
    }


def write_provenance(weights_file: Path, facts: Mapping[str, Any]) -> None:
    """Write facts and versions atomically as JSON beside a weights file.

    Raises: InputError when the disk is full or not writable.
    """
    text = json.dumps({**facts, "versions": versions()}, indent=1, default=str) + "\n"
    write_atomic(weights_file.with_suffix(".json"), text.encode())


def read_provenance(weights_file: Path) -> dict[str, Any] | None:
    """Read the facts beside a weights file; None if there is no provenance file.

    Raises: InputError naming a provenance file that cannot be read.
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


def _history(weights_file: Path) -> Iterator[dict[str, Any]]:
    """Yield the facts of weights, then those of the weights that they started from, and so on."""
    facts = read_provenance(weights_file)
    while facts:
        yield facts
        facts = facts.get("before")


def shared_scenes(seen: Collection[tuple[str, str, str]], measured: Collection[tuple[str, str, str]]) -> list[str]:
    """Return the measured scenes' names that agree with a seen scene in data set and name, in content, or in street.

    Scenes: data set, name and content hash. A seen scene with an empty data set matches by its name alone. An empty
    hash means unknown. A street in other weather is the same street.
    """
    places, hashes = {independent_group_of(*scene[:2]) for scene in seen}, {value for *_, value in seen if value}
    return sorted(
        {
            name
            for dataset, name, value in measured
            if {independent_group_of(dataset, name), independent_group_of("", name)} & places or value in hashes
        }
    )


def refuse_tuned_scenes(weights_file: Path, scenes: Collection[tuple[str, str, str]]) -> None:
    """Refuse to measure weights on scenes that they, or the weights they started from, were fine-tuned on.

    scenes: as in `shared_scenes`. Weights without provenance or without fine-tuning pass.
    Raises: InputError naming the scenes, or a provenance file that cannot be read.
    """
    tuned: set[tuple[str, str, str]] = set()
    for facts in _history(weights_file):
        found = (facts.get("finetuned_on") or {}).get("scenes", [])
        # Older provenance files hold a dict of hashes by name.
        tuned.update([("", *scene) for scene in found.items()] if isinstance(found, dict) else map(tuple, found))
    if both := shared_scenes(tuned, scenes):
        what = f"was fine-tuned on {', '.join(both[:5])}{' and others' if len(both) > 5 else ''}"
        raise InputError(what, where=str(weights_file), remedy="Measure it on scenes that it has not seen")


def trained_frames(weights_file: Path, scenes: Collection[tuple[str, str, str]]) -> list[str]:
    """Return the measured scenes' names that frames of the training of weights, or of their start, have too.

    The provenance holds names, no content: frames of equal names in another folder count too.
    scenes: as in `shared_scenes`. Raises: InputError naming a provenance file that cannot be read.
    """
    made_on = [facts["scenes"] for facts in _history(weights_file) if isinstance(facts.get("scenes"), dict)]
    seen = [(str(data.get("dataset", "")), name, "") for data in made_on for name in data.get("names", [])]
    return shared_scenes(seen, scenes)
