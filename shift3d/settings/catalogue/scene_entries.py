"""What a plan has to know of each scene: from its configuration, from the cache, or by looking at it.

What was found out by looking is kept in the user's cache folder: a file a scene, under a name that changes with
everything its content depends on: its configuration or the state of its files, the source of this program that makes
scenes, the libraries under it and the machine. A cache that cannot be written is done without.

Source: our choice.
"""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import TypeAdapter

from shift3d.errors import InputError
from shift3d.processor import usable_cpus
from shift3d.progress_bar import progress_bar
from shift3d.scenes.facts import SceneFacts
from shift3d.store.user_cache import keep, program_digest, read_kept, user_cache

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet

# What scenes are made by, and what an entry is.
_SOURCES = ("scenes", "vehicles", "sdf", "geometry", "seeding.py", "settings/catalogue/scene_entries.py")
_FEW = 8
"""So many scenes are made for a preview, too: it takes seconds, and then the preview is exact."""


@dataclass(frozen=True)
class SceneEntry:
    """One scene: its name in the set, its data set, the hash of its content, and what it may call for.

    content_hash: empty where the scene has not been made yet and its configuration says the rest.
    """

    name: str
    dataset: str
    content_hash: str
    facts: SceneFacts


def scene_entries(
    scenes: SceneSet, preview: bool = False, skip_bad: bool | None = None
) -> tuple[tuple[SceneEntry, ...], dict[str, str]]:
    """An entry a scene, in order. A bar on stderr shows how many of those that have to be looked at are left.

    Args:
        preview: leave ``content_hash`` empty where many scenes would have to be made for it alone.
        skip_bad: leave out scenes that cannot be read. None: no setting of these scenes.

    Returns: the entries, and of each scene that is left out why.

    Raises: InputError: a scene cannot be read; with skip_bad, none can.
    """
    entries = {name: _known(scenes, name) for name in scenes.names()}
    unknown = [name for name, entry in entries.items() if entry is None or not entry.content_hash]
    if preview and len(unknown) > _FEW:
        unknown = [name for name in unknown if entries[name] is None]
    looked_at = dict(zip(unknown, _look(scenes, unknown, skip_bad), strict=True))
    skipped = {name: found for name, found in looked_at.items() if isinstance(found, InputError)}
    if skipped and len(skipped) == len(entries):
        raise next(iter(skipped.values()))
    entries |= {name: found for name, found in looked_at.items() if isinstance(found, SceneEntry)}
    found = tuple(entry for name, entry in entries.items() if entry is not None and name not in skipped)
    return found, {name: str(error) for name, error in skipped.items()}


def _known(scenes: SceneSet, name: str) -> SceneEntry | None:
    """What is known of a scene without looking at it. The configuration goes first: it decides the same everywhere,
    whatever is in a cache."""
    kept, configured = _kept(scenes.source(name)), scenes.configured(name)
    if configured is None:
        return kept
    dataset, facts = configured
    return SceneEntry(name, dataset, kept.content_hash if kept else "", facts)


def _look(scenes: SceneSet, names: Sequence[str], skip_bad: bool | None) -> list[SceneEntry | InputError]:
    """Load scenes, by a thread for each CPU of this process: most of it is arithmetic that lets other threads run.

    skip_bad: the error of one that cannot be read stands in its place.
    """
    with ThreadPoolExecutor(usable_cpus()) as threads:
        try:
            work = threads.map(lambda name: _look_at(scenes, name, skip_bad), names)
            # delay: nothing is shown of what is done at once
            return list(progress_bar(work, desc="looking at scenes", total=len(names), unit="scene", delay=1.0))
        except BaseException:
            threads.shutdown(cancel_futures=True)
            raise


def _look_at(scenes: SceneSet, name: str, skip_bad: bool | None) -> SceneEntry | InputError:
    source = scenes.source(name)  # before the files are read: one that changes meanwhile is looked at again
    try:
        scene = scenes.load(name)
    except InputError as error:
        if skip_bad:
            return error
        if skip_bad is None:
            raise
        remedy = f"{error.remedy.rstrip('.')}; or leave such frames out: scenes.skip_bad=true"
        raise InputError(error.what, error.where, remedy) from error
    entry = SceneEntry(name, scene.dataset, scene.content_hash(), SceneFacts.of(scene))
    keep(_file(source), json.dumps(asdict(entry)).encode())
    configured = scenes.configured(name)
    return entry if configured is None else replace(entry, facts=configured[1])


def _kept(source: Sequence[object]) -> SceneEntry | None:
    """The entry that was kept for a scene, None where there is none. source: as `SceneSet.source` has it."""
    content = read_kept(_file(source))
    return None if content is None else _entries().validate_python(json.loads(content))


@functools.cache
def _entries() -> TypeAdapter[SceneEntry]:
    """What reads entries: it takes milliseconds to make, and a data set has thousands of scenes."""
    return TypeAdapter(SceneEntry)


def _file(source: Sequence[object]) -> Path:
    key = hashlib.blake2b(json.dumps([_program(), *source]).encode(), digest_size=16).hexdigest()
    return user_cache() / "scenes" / key


def _program() -> str:
    """A hash of what makes scenes on this machine."""
    return f"{platform.node()}\n{program_digest(*_SOURCES)}"
