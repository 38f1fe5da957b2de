"""Ids of many tasks at once: the parts that tasks share are serialized and hashed once.

An id equals `TaskSpec.task_id` bit for bit. A task template is a spec without its scene. A task scene is what differs
between the scenes of one template: the scene, its hash, and the other scenes of its shape.
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

TaskScene = tuple[str, str, tuple[TransferScene, ...]]
"""Name of a scene, hash of its content, and the scenes of transfers."""
_VARYING = ("scene", "scene_hash", "transfer_scenes")
_DIGEST = 16


def _json(value: Any) -> str:
    """Return canonical JSON, with dataclasses as their fields. Raises TypeError for other objects."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=dataclasses.asdict)


def spec_in_scene(template: TaskSpec, task_scene: TaskScene, task_id: str) -> TaskSpec:
    """Return the spec of a template in a scene. task_id: its id, which is not computed again."""
    scene, scene_hash, others = task_scene
    spec = dataclasses.replace(template, scene=scene, scene_hash=scene_hash, transfer_scenes=others)
    vars(spec)["task_id"] = task_id  # where functools.cached_property looks for it
    return spec


def template_json(template: TaskSpec) -> str:
    """Return the canonical JSON of a template, without the scene."""
    return _json(_shared_values(template))


def _shared_values(template: TaskSpec) -> dict[str, Any]:
    return {name: value for name, value in template.to_dict().items() if name not in _VARYING}


def read_template(text: str) -> TaskSpec:
    """Parse the text of :func:`template_json`. Raises ValueError, KeyError or TypeError for another text or version."""
    return TaskSpec.from_dict({**json.loads(text), "scene": "", "scene_hash": ""})


def task_scene_json(task_scene: TaskScene) -> str:
    """Return the canonical JSON of a task scene."""
    return _json(dict(zip(_VARYING, task_scene, strict=True)))


def read_task_scene(text: str) -> TaskScene:
    """Parse the text of :func:`task_scene_json`. Raises ValueError, KeyError or TypeError for another text."""
    values = json.loads(text)
    return values["scene"], values["scene_hash"], tuple(map(TransferScene.of, values.get("transfer_scenes", ())))


def task_ids(
    templates: Sequence[TaskSpec], task_scenes: Sequence[TaskScene], template: np.ndarray, task_scene: np.ndarray
) -> pa.Array:
    """Return the id of each task, an Arrow array of strings.

    Args: template, task_scene: int32, of each task: indices into ``templates`` and ``task_scenes``.
    """
    texts = [(_json(scene), _json(scene_hash), _json(others)) for scene, scene_hash, others in task_scenes]
    order = np.argsort(template, kind="stable")
    found = np.empty((len(template), 2 * _DIGEST), dtype=np.uint8)
    for positions in np.split(order, np.flatnonzero(np.diff(template[order])) + 1):
        if len(positions):
            digests = _digests(templates[int(template[positions[0]])], texts, task_scene[positions].tolist())
            found[positions] = np.frombuffer(digests.hex().encode(), dtype=np.uint8).reshape(-1, 2 * _DIGEST)
    offsets = np.arange(0, found.size + 1, 2 * _DIGEST, dtype=np.int32)
    return pa.StringArray.from_buffers(len(template), pa.py_buffer(offsets), pa.py_buffer(found))


def _digests(template: TaskSpec, texts: Sequence[tuple[str, str, str]], task_scenes: Sequence[int]) -> bytes:
    """Return the concatenated digests of one template's tasks; the part before the scene is hashed once."""
    start, between, before_transfers, end = _template_parts(template)
    shared = hashlib.blake2b(start.encode(), digest_size=_DIGEST)
    found = []
    for task_scene in task_scenes:
        scene, scene_hash, transfers = texts[task_scene]
        state = shared.copy()
        state.update(f"{scene}{between}{scene_hash}{before_transfers}{transfers}{end}".encode())
        found.append(state.digest())
    return b"".join(found)


def _template_parts(template: TaskSpec) -> tuple[str, str, str, str]:
    """Return the canonical JSON of a spec, cut at the scene, its hash and the scenes of transfers."""
    values = _shared_values(template)
    first, second, third = _VARYING
    cuts: list[list[str]] = [[], [], [], []]
    for name in sorted(values):
        cuts[(name > first) + (name > second) + (name > third)].append(f"{_json(name)}:{_json(values[name])}")
    before, between, after, end = (",".join(part) for part in cuts)
    return f'{{{before},"{first}":', f',{between},"{second}":', f',{after},"{third}":', f",{end}}}"
