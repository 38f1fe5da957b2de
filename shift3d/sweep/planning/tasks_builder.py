"""Builder of a plan's tasks from the tasks of each combination of settings, each task once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from shift3d.sweep.planning.task_ids import TaskScene, task_ids, task_scene_json
from shift3d.sweep.planning.tasks import PlannedTask, Tasks
from shift3d.task.spec import TaskSpec


@dataclasses.dataclass
class _Chunk:
    """Tasks of one combination of settings. template, task_scene: indices into the builder's lists."""

    template: np.ndarray
    task_scene: np.ndarray
    assets: int
    requested: str


class TasksBuilder:
    """Builder of tasks; a task that is added twice is one task, at its first place in the order."""

    def __init__(self) -> None:
        self._templates: dict[str, int] = {}
        self._template_specs: list[TaskSpec] = []
        self._task_scenes: dict[TaskScene, int] = {}
        self._chunks: list[_Chunk] = []

    def template(self, spec: TaskSpec) -> int:
        """Return the number of a spec without its task scene; equal specs have one number."""
        template = dataclasses.replace(spec, scene="", scene_hash="", transfer_scenes=())
        number = self._templates.setdefault(template.canonical_json(), len(self._templates))
        if number == len(self._template_specs):
            self._template_specs.append(template)
        return number

    def task_scene(self, task_scene: TaskScene) -> int:
        """Return the number of a task scene; equal ones have one number."""
        return self._task_scenes.setdefault(task_scene, len(self._task_scenes))

    def add(self, template: np.ndarray, task_scene: np.ndarray, assets: int, requested: str) -> None:
        """Add tasks of one setting of effects, in order: numbers of their templates and task scenes."""
        chunk = _Chunk(template.astype(np.int32), task_scene.astype(np.int32), assets, requested)
        self._chunks.append(chunk)

    def tasks(self) -> Tasks:
        """Return all added tasks, each once."""
        task_scenes = list(self._task_scenes)
        empty = np.zeros(0, dtype=np.int32)
        template = np.concatenate([empty, *(chunk.template for chunk in self._chunks)])
        task_scene = np.concatenate([empty, *(chunk.task_scene for chunk in self._chunks)])
        key = template.astype(np.int64) * max(len(task_scenes), 1) + task_scene
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        order = np.argsort(first)
        requested, requested_values = self._requested(np.argsort(order)[inverse], len(order))
        at = first[order]
        sizes = [len(chunk.template) for chunk in self._chunks]
        assets = np.repeat(np.array([chunk.assets for chunk in self._chunks], dtype=np.int32), sizes)
        template, task_scene = template[at], task_scene[at]
        return Tasks(
            templates=tuple(self._template_specs),
            task_scenes=pa.array([task_scene_json(found) for found in task_scenes], type=pa.string()),
            template=template,
            task_scene=task_scene,
            assets=assets[at],
            requested=requested,
            requested_values=requested_values,
            ids=task_ids(self._template_specs, task_scenes, template, task_scene),
        )

    def _requested(self, task: np.ndarray, count: int) -> tuple[np.ndarray, tuple[tuple[str, ...], ...]]:
        """Return, for each task, the index of its tuple of requested effect settings, and the list of these tuples.

        task: task number of each added row, in order.
        """
        values: dict[tuple[str, ...], int] = {}
        requested = np.full(count, -1, dtype=np.int32)
        start = 0
        for chunk in self._chunks:
            own = task[start : start + len(chunk.template)]
            start += len(own)
            before = requested[own]
            for code in np.unique(before).tolist():
                known = () if code < 0 else list(values)[code]
                also = known if chunk.requested in known else (*known, chunk.requested)
                requested[own[before == code]] = values.setdefault(also, len(values))
        return requested, tuple(values)


def tasks_of(planned: Iterable[PlannedTask]) -> Tasks:
    """Return planned tasks as columns, each once."""
    builder = TasksBuilder()
    for task in planned:
        spec = task.spec
        template = np.array([builder.template(spec)])
        task_scene = np.array([builder.task_scene((spec.scene, spec.scene_hash, spec.transfer_scenes))])
        for requested in task.effects_requested:
            builder.add(template, task_scene, task.assets, requested)
    return builder.tasks()
