"""Scene entries of a plan: facts and content hash of each scene, from configuration, cache, or the loaded scene.

The user's cache folder stores one file per loaded scene. The file's name is a hash of everything that the content
depends on: the scene's configuration or the state of its files, the code that makes scenes, the libraries and the
machine. The program also works without a writable cache.

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
from shift3d.store.user_cache import cache_result, program_digest, read_cached, user_cache

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet

# Code that makes scenes and defines entries: part of the cache key.
_SOURCES = ("scenes", "vehicles", "sdf", "geometry", "seeding.py", "settings/catalogue/scene_entries.py")
_FEW = 8
"""A preview also loads up to this many scenes: that takes seconds and makes the preview exact."""


@dataclass(frozen=True)
class SceneEntry:
    """One scene: name in the set, data set, content hash, and facts that decide on effects.

    content_hash: empty if the configuration gives the facts and the scene has not been generated yet.
    """

    name: str
    dataset: str
    content_hash: str
    facts: SceneFacts


def scene_entries(
    scenes: SceneSet, preview: bool = False, skip_bad: bool | None = None
) -> tuple[tuple[SceneEntry, ...], dict[str, str]]:
    """Return an entry per scene, in order, and the reason for each scene left out. A progress bar counts loaded scenes.

    preview: leave ``content_hash`` empty if many scenes would have to be generated for their hash alone. skip_bad:
    leave out unreadable scenes; None: these scenes have no such setting.

    Raises: InputError: a scene is unreadable; with skip_bad, all scenes are.
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
    """Return the entry of a scene that needs no loading. The configuration wins over the cache, because it gives the
    same facts on every machine."""
    kept, configured = _kept(scenes.source(name)), scenes.configured(name)
    if configured is None:
        return kept
    dataset, facts = configured
    return SceneEntry(name, dataset, kept.content_hash if kept else "", facts)


def _look(scenes: SceneSet, names: Sequence[str], skip_bad: bool | None) -> list[SceneEntry | InputError]:
    """Load scenes with one thread per CPU of this process: most of the work is arithmetic that releases the GIL.

    skip_bad: return the error of an unreadable scene in place of its entry.
    """
    with ThreadPoolExecutor(usable_cpus()) as threads:
        try:
            work = threads.map(lambda name: _look_at(scenes, name, skip_bad), names)
            # delay: no bar for work that ends within a second
            return list(progress_bar(work, desc="looking at scenes", total=len(names), unit="scene", delay=1.0))
        except BaseException:
            threads.shutdown(cancel_futures=True)
            raise


def _look_at(scenes: SceneSet, name: str, skip_bad: bool | None) -> SceneEntry | InputError:
    source = scenes.source(name)  # before the files are read: a file that changes meanwhile is loaded again next time
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
    cache_result(_file(source), json.dumps(asdict(entry)).encode())
    configured = scenes.configured(name)
    return entry if configured is None else replace(entry, facts=configured[1])


def _kept(source: Sequence[object]) -> SceneEntry | None:
    """Return a scene's entry from the cache, or None. source: value of `SceneSet.source`."""
    content = read_cached(_file(source))
    return None if content is None else _entries().validate_python(json.loads(content))


@functools.cache
def _entries() -> TypeAdapter[SceneEntry]:
    """Return the parser of entries, made once: making it takes milliseconds, and a data set has thousands of scenes."""
    return TypeAdapter(SceneEntry)


def _file(source: Sequence[object]) -> Path:
    key = hashlib.blake2b(json.dumps([_program(), *source]).encode(), digest_size=16).hexdigest()
    return user_cache() / "scenes" / key


def _program() -> str:
    """Identify this machine and the code and libraries that make scenes on it."""
    return f"{platform.node()}\n{program_digest(*_SOURCES)}"
