"""What was found out about scenes by making or reading them, kept in the user's cache folder.

A file a scene, under a name that changes with everything its content depends on: its configuration or the state of its
files, the source of this program that makes scenes, the libraries under it and the machine. A cache that cannot be
written is done without.

Source: our choice.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from shift3d.errors import InputError
from shift3d.scenes.facts import SceneFacts
from shift3d.store.atomic import write_atomic
from shift3d.store.user_cache import program_digest, user_cache

# Layers that scenes are made by.
_SOURCES = ("scenes", "vehicles", "sdf", "geometry", "seeding.py")


@dataclass(frozen=True)
class SceneEntry:
    """One scene: its name in the set, its data set, the hash of its content, and what it may call for.

    content_hash: empty where the scene has not been made yet and its configuration says the rest.
    """

    name: str
    dataset: str
    content_hash: str
    facts: SceneFacts


def kept_entry(source: Sequence[object]) -> SceneEntry | None:
    """The entry that was kept for a scene. source: as `SceneSet.source` has it."""
    try:
        return TypeAdapter(SceneEntry).validate_python(json.loads(_file(source).read_bytes()))
    except (OSError, ValueError, ValidationError, RecursionError):
        return None


def keep_entry(source: Sequence[object], entry: SceneEntry) -> None:
    """Keep an entry for `kept_entry`."""
    with contextlib.suppress(InputError, OSError):
        write_atomic(_file(source), json.dumps(asdict(entry)).encode())


def _file(source: Sequence[object]) -> Path:
    key = hashlib.blake2b(json.dumps([_program(), *source]).encode(), digest_size=16).hexdigest()
    return user_cache() / "scenes" / f"{key}.json"


def _program() -> str:
    """A hash of what makes scenes on this machine."""
    return f"{platform.node()}\n{program_digest(*_SOURCES)}"
