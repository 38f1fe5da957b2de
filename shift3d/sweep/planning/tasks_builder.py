"""Tasks put together from what each combination of settings asks for, each task once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from shift3d.sweep.planning.task_ids import Place, ground_of, place_json, task_ids
from shift3d.sweep.planning.tasks import PlannedTask, Tasks
from shift3d.task.spec import TaskSpec

__all__ = ["TasksBuilder", "tasks_of"]


@dataclasses.dataclass
class _Chunk:
    """What one combination of settings asks for: places in the builder's lists."""

    ground: np.ndarray
    place: np.ndarray
    assets: int
    asked: str


class TasksBuilder:
    """Collects tasks; those that are asked for again are one task, at its first place in the order."""

    def __init__(self) -> None:
        self._grounds: dict[str, int] = {}
        self._ground_specs: list[TaskSpec] = []
        self._places: dict[Place, int] = {}
        self._chunks: list[_Chunk] = []

    def ground(self, spec: TaskSpec) -> int:
        """The number of a spec without its place; the same for equal ones."""
        ground = ground_of(spec)
        number = self._grounds.setdefault(ground.canonical_json(), len(self._grounds))
        if number == len(self._ground_specs):
            self._ground_specs.append(ground)
        return number

    def place(self, place: Place) -> int:
        """The number of a place; the same for equal ones."""
        return self._places.setdefault(place, len(self._places))

    def add(self, ground: np.ndarray, place: np.ndarray, assets: int, asked: str) -> None:
        """Tasks of one setting of effects, in order: numbers of their grounds and their places."""
        chunk = _Chunk(ground.astype(np.int32), place.astype(np.int32), assets, asked)
        self._chunks.append(chunk)

    def tasks(self) -> Tasks:
        """All tasks that were added, each once."""
        places = list(self._places)
        empty = np.zeros(0, dtype=np.int32)
        ground = np.concatenate([empty, *(chunk.ground for chunk in self._chunks)])
        place = np.concatenate([empty, *(chunk.place for chunk in self._chunks)])
        key = ground.astype(np.int64) * max(len(places), 1) + place
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        order = np.argsort(first)
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order))
        asked, asked_values = self._asked(rank[inverse], len(order))
        at = first[order]
        sizes = [len(chunk.ground) for chunk in self._chunks]
        assets = np.repeat(np.array([chunk.assets for chunk in self._chunks], dtype=np.int32), sizes)
        ground, place = ground[at], place[at]
        return Tasks(
            grounds=tuple(self._ground_specs),
            places=pa.array([place_json(found) for found in places], type=pa.string()),
            ground=ground,
            place=place,
            assets=assets[at],
            asked=asked,
            asked_values=asked_values,
            ids=task_ids(self._ground_specs, places, ground, place),
        )

    def _asked(self, task: np.ndarray, count: int) -> tuple[np.ndarray, tuple[tuple[str, ...], ...]]:
        """Of each task the settings of effects that ask for it, in order, as numbers into their list.

        task: of everything that was added, in order, the task that it is.
        """
        values: dict[tuple[str, ...], int] = {}
        asked = np.full(count, -1, dtype=np.int32)
        start = 0
        for chunk in self._chunks:
            own = task[start : start + len(chunk.ground)]
            start += len(own)
            before = asked[own]
            for code in np.unique(before).tolist():
                said = () if code < 0 else list(values)[code]
                also = said if chunk.asked in said else (*said, chunk.asked)
                asked[own[before == code]] = values.setdefault(also, len(values))
        return asked, tuple(values)


def tasks_of(planned: Iterable[PlannedTask]) -> Tasks:
    """Planned tasks as columns, each once."""
    builder = TasksBuilder()
    for task in planned:
        spec = task.spec
        ground = np.array([builder.ground(spec)])
        place = np.array([builder.place((spec.scene, spec.scene_hash, spec.transfer_scenes))])
        for asked in task.effects_asked:
            builder.add(ground, place, task.assets, asked)
    return builder.tasks()
