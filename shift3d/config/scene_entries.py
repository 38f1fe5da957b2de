"""What a plan has to know of each scene: from its configuration, from the cache, or by looking at it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

from shift3d.config.scene_cache import SceneEntry, keep_entry, kept_entry
from shift3d.scenes.facts import SceneFacts

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet

__all__ = ["scene_entries"]

_FEW = 8
"""So many scenes are made for a preview, too: it takes seconds, and then the preview is exact."""


def scene_entries(scenes: SceneSet, preview: bool = False) -> tuple[SceneEntry, ...]:
    """An entry a scene, in order. A bar on stderr shows how many of those that have to be looked at are left.

    Args:
        preview: leave ``content_hash`` empty where many scenes would have to be made for it alone.

    Raises:
        InputError: a scene cannot be read.
    """
    entries = {name: _known(scenes, name) for name in scenes.names()}
    unknown = [name for name, entry in entries.items() if entry is None or not entry.content_hash]
    if preview and len(unknown) > _FEW:
        unknown = [name for name in unknown if entries[name] is None]
    entries |= zip(unknown, _look(scenes, unknown), strict=True)
    return tuple(entry for entry in entries.values() if entry is not None)


def _known(scenes: SceneSet, name: str) -> SceneEntry | None:
    """What is known of a scene without looking at it. The configuration goes first: it decides the same everywhere,
    whatever is in a cache."""
    kept, configured = kept_entry(scenes.source(name)), scenes.configured(name)
    if configured is None:
        return kept
    dataset, facts = configured
    return SceneEntry(name, dataset, kept.content_hash if kept else "", facts)


def _look(scenes: SceneSet, names: Sequence[str]) -> list[SceneEntry]:
    """Load scenes, by a thread a core: most of it is arithmetic that lets other threads run."""
    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        try:
            return list(
                tqdm(
                    threads.map(lambda name: _look_at(scenes, name), names),
                    desc="looking at scenes",
                    total=len(names),
                    unit="scene",
                    delay=1.0,  # nothing is shown of what is done at once
                    dynamic_ncols=True,
                    mininterval=0.2 if terminal else 15.0,
                    file=sys.stderr,
                )
            )
        except BaseException:
            threads.shutdown(cancel_futures=True)
            raise


def _look_at(scenes: SceneSet, name: str) -> SceneEntry:
    source = scenes.source(name)  # before the files are read: one that changes meanwhile is looked at again
    scene = scenes.load(name)
    entry = SceneEntry(name, scene.dataset, scene.content_hash(), SceneFacts.of(scene))
    keep_entry(source, entry)
    configured = scenes.configured(name)
    return entry if configured is None else replace(entry, facts=configured[1])
