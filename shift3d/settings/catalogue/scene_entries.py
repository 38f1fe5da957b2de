"""What a plan has to know of each scene: from its configuration, from the cache, or by looking at it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

from shift3d.errors import InputError
from shift3d.progress_bar import progress_bar
from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.scene_cache import SceneEntry, keep_entry, kept_entry

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet

_FEW = 8
"""So many scenes are made for a preview, too: it takes seconds, and then the preview is exact."""


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
    kept, configured = kept_entry(scenes.source(name)), scenes.configured(name)
    if configured is None:
        return kept
    dataset, facts = configured
    return SceneEntry(name, dataset, kept.content_hash if kept else "", facts)


def _look(scenes: SceneSet, names: Sequence[str], skip_bad: bool | None) -> list[SceneEntry | InputError]:
    """Load scenes, by a thread a core: most of it is arithmetic that lets other threads run.

    skip_bad: the error of one that cannot be read stands in its place.
    """
    with ThreadPoolExecutor(os.cpu_count()) as threads:
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
    keep_entry(source, entry)
    configured = scenes.configured(name)
    return entry if configured is None else replace(entry, facts=configured[1])
