"""Ids of many tasks at once: what tasks share is written and hashed once.

An id is that of `TaskSpec.task_id`, bit for bit. A ground is a spec without its place; a place is what differs between
the scenes of one setting: the scene, its hash, and the other scenes that a shape is put into.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from shift3d.task.spec import TaskSpec, TransferScene

__all__ = ["Place", "at_place", "ground_json", "ground_of", "place_json", "read_ground", "read_place", "task_ids"]

Place = tuple[str, str, tuple[TransferScene, ...]]
"""A scene, the hash of its content, and the scenes of transfers."""
_VARYING = ("scene", "scene_hash", "transfer_scenes")
_DIGEST = 16


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def ground_of(spec: TaskSpec) -> TaskSpec:
    """The spec without its place."""
    return dataclasses.replace(spec, scene="", scene_hash="", transfer_scenes=())


def at_place(ground: TaskSpec, place: Place, task_id: str | None = None) -> TaskSpec:
    """The spec of a ground at a place. task_id: where it is known already."""
    scene, scene_hash, others = place
    spec = dataclasses.replace(ground, scene=scene, scene_hash=scene_hash, transfer_scenes=others)
    if task_id is not None:
        vars(spec)["task_id"] = task_id  # where functools.cached_property looks for it
    return spec


def ground_json(ground: TaskSpec) -> str:
    """The one spelling of a ground: its canonical JSON without the place."""
    return _json({name: value for name, value in ground.to_dict().items() if name not in _VARYING})


def read_ground(text: str) -> TaskSpec:
    """The inverse of :func:`ground_json`. Raises ValueError, KeyError or TypeError for another text or version."""
    return TaskSpec.from_dict({**json.loads(text), "scene": "", "scene_hash": ""})


def place_json(place: Place) -> str:
    """The one spelling of a place."""
    scene, scene_hash, others = place
    values: dict[str, Any] = {"scene": scene, "scene_hash": scene_hash}
    if others:
        values["transfer_scenes"] = [{**vars(other), "effects": list(other.effects)} for other in others]
    return _json(values)


def read_place(text: str) -> Place:
    """The inverse of :func:`place_json`. Raises ValueError, KeyError or TypeError for another text."""
    values = json.loads(text)
    others = tuple(
        TransferScene(other["scene"], other["scene_hash"], tuple(other["effects"]))
        for other in values.get("transfer_scenes", ())
    )
    return values["scene"], values["scene_hash"], others


def task_ids(grounds: Sequence[TaskSpec], places: Sequence[Place], ground: np.ndarray, place: np.ndarray) -> pa.Array:
    """The id of each task, an Arrow array of strings.

    Args:
        ground, place: int32, of each task: its place in ``grounds`` and in ``places``.
    """
    texts = [_place_parts(found) for found in places]
    order = np.argsort(ground, kind="stable")
    found = np.empty((len(ground), 2 * _DIGEST), dtype=np.uint8)
    for positions in np.split(order, np.flatnonzero(np.diff(ground[order])) + 1):
        if len(positions):
            digests = _digests(grounds[int(ground[positions[0]])], texts, place[positions].tolist())
            found[positions] = np.frombuffer(digests.hex().encode(), dtype=np.uint8).reshape(-1, 2 * _DIGEST)
    offsets = np.arange(0, found.size + 1, 2 * _DIGEST, dtype=np.int32)
    return pa.StringArray.from_buffers(len(ground), pa.py_buffer(offsets), pa.py_buffer(found))


def _place_parts(place: Place) -> tuple[bytes, bytes, bytes]:
    scene, scene_hash, others = place
    listed = [{**vars(other), "effects": list(other.effects)} for other in others]
    transfers = f',"transfer_scenes":{_json(listed)}' if listed else ""  # see TaskSpec.to_dict
    return _json(scene).encode(), _json(scene_hash).encode(), transfers.encode()


def _digests(ground: TaskSpec, texts: Sequence[tuple[bytes, bytes, bytes]], places: Sequence[int]) -> bytes:
    """The digests of one ground's tasks, one after the other: all up to the scene is hashed once."""
    start, between, before_transfers, end = _ground_parts(ground)
    shared = hashlib.blake2b(start, digest_size=_DIGEST)
    found = []
    for place in places:
        scene, scene_hash, transfers = texts[place]
        state = shared.copy()
        state.update(scene + between + scene_hash + before_transfers + transfers + end)
        found.append(state.digest())
    return b"".join(found)


def _ground_parts(ground: TaskSpec) -> tuple[bytes, bytes, bytes, bytes]:
    """The canonical JSON of a spec, cut where the scene, its hash and the scenes of transfers stand."""
    values = {name: value for name, value in ground.to_dict().items() if name not in _VARYING}
    first, second, third = _VARYING
    cuts: list[list[str]] = [[], [], [], []]
    for name in sorted(values):
        cuts[(name > first) + (name > second) + (name > third)].append(f"{_json(name)}:{_json(values[name])}")
    before, between, after, end = (",".join(part) for part in cuts)
    parts = (
        f'{{{before},"{first}":',
        f',{between},"{second}":',
        f",{after}",
        f",{end}}}",
    )
    return tuple(part.encode() for part in parts)  # type: ignore[return-value]
