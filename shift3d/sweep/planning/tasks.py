"""A plan's tasks as columns: a million of them in a few tens of megabytes, shared between processes without a copy."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shift3d.sweep.planning.task_ids import at_place, read_place
from shift3d.task.spec import TaskSpec

__all__ = ["PlannedTask", "TaskGroup", "Tasks"]


@dataclass(frozen=True)
class PlannedTask:
    """A task and what its worker needs loaded (an index into ``Plan.assets``).

    effects_asked: the settings of effects that lead to this task, one or more: "auto", "none", or names joined by +.
    """

    spec: TaskSpec
    assets: int
    effects_asked: tuple[str, ...] = ("none",)


@dataclass(frozen=True)
class TaskGroup:
    """Tasks that differ in their scene alone. ground: their spec without its scene. tasks: how many there are."""

    ground: TaskSpec
    effects_asked: tuple[str, ...]
    tasks: int


@dataclass(frozen=True, eq=False)
class Tasks(Sequence[PlannedTask]):
    """Tasks in plan order. ``tasks[i]`` is made when it is asked for; a slice is Tasks again.

    Its columns are Arrow and NumPy buffers, which pickle (protocol 5) passes out of band: Ray's object store holds
    them once for all workers of a machine, so that a worker can be given the tasks once and positions a call.

    grounds: specs without their place. places: the JSON of scenes, see `task_ids.place_json`. ground, place, assets,
    asked: int32, of each task: indices into grounds, places, ``Plan.assets`` and asked_values. ids: Arrow strings.

    Source: our choice.
    """

    grounds: tuple[TaskSpec, ...]
    places: pa.Array
    ground: np.ndarray
    place: np.ndarray
    assets: np.ndarray
    asked: np.ndarray
    asked_values: tuple[tuple[str, ...], ...]
    ids: pa.Array

    def __len__(self) -> int:
        return len(self.ground)

    @overload
    def __getitem__(self, index: int) -> PlannedTask: ...
    @overload
    def __getitem__(self, index: slice) -> Tasks: ...
    def __getitem__(self, index: int | slice) -> PlannedTask | Tasks:
        if isinstance(index, slice):
            return self.select(np.arange(len(self))[index])
        if not -len(self) <= index < len(self):
            raise IndexError(f"task {index} of {len(self)}")
        index %= len(self)
        place = read_place(self.places[int(self.place[index])].as_py())
        spec = at_place(self.grounds[self.ground[index]], place, self.ids[index].as_py())
        return PlannedTask(spec, int(self.assets[index]), self.asked_values[self.asked[index]])

    def __iter__(self) -> Iterator[PlannedTask]:
        return (self[index] for index in range(len(self)))

    def __eq__(self, other: object) -> bool:
        """Whether the same tasks stand in the same order, with the same assets and settings of effects."""
        if not isinstance(other, Tasks):
            return NotImplemented
        if not (self.ids.equals(other.ids) and np.array_equal(self.assets, other.assets)):
            return False
        if self.asked_values == other.asked_values:
            return np.array_equal(self.asked, other.asked)
        return all(
            self.asked_values[one] == other.asked_values[two] for one, two in zip(self.asked, other.asked, strict=True)
        )

    __hash__ = None  # type: ignore[assignment]

    def select(self, positions: Sequence[int] | np.ndarray) -> Tasks:
        """The tasks at some positions, in the order of the positions. Raises IndexError beyond the last one."""
        chosen = np.asarray(positions, dtype=np.int64)
        columns = {name: getattr(self, name)[chosen] for name in ("ground", "place", "assets", "asked")}
        return replace(self, **columns, ids=self.ids.take(pa.array(chosen)))

    def starting_with(self, prefix: str) -> Tasks:
        """The tasks whose id begins with a text."""
        return self.select(np.flatnonzero(pc.starts_with(self.ids, prefix).to_numpy(zero_copy_only=False)))

    def without(self, ids: Collection[str]) -> np.ndarray:
        """Positions of the tasks whose id is not among some, in order."""
        found = pc.is_in(self.ids, value_set=pa.array(list(ids), type=pa.string()))
        return np.flatnonzero(~found.to_numpy(zero_copy_only=False))

    def groups(self) -> list[TaskGroup]:
        """The tasks counted by what does not depend on the scene, in the order of each group's first task."""
        key = self.ground.astype(np.int64) * len(self.asked_values) + self.asked
        keys, first, counts = np.unique(key, return_index=True, return_counts=True)
        found = []
        for index in np.argsort(first):
            ground, asked = divmod(int(keys[index]), len(self.asked_values))
            found.append(TaskGroup(self.grounds[ground], self.asked_values[asked], int(counts[index])))
        return found

    def kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """Tasks that differ in which scenes they are in alone, not in how many their shape is put into.

        Returns: the position of each kind's first task, ascending, and of each task its kind.
        """
        others = self._others[self.place]
        key = self.ground.astype(np.int64) * (int(others.max(initial=0)) + 1) + others
        _, first, kind = np.unique(key, return_index=True, return_inverse=True)
        order = np.argsort(first)
        return first[order], np.argsort(order)[kind]

    @functools.cached_property
    def _others(self) -> np.ndarray:
        return np.array([len(read_place(text)[2]) for text in self.places.to_pylist()], dtype=np.int64)

    def scenes(self) -> list[tuple[str, str]]:
        """The scenes that tasks are in, (data set, name), in the order of their first task."""
        names = list(dict.fromkeys(ground.dataset for ground in self.grounds))
        dataset = np.array([names.index(ground.dataset) for ground in self.grounds], dtype=np.int64)
        keys, first = np.unique(dataset[self.ground] * len(self.places) + self.place, return_index=True)
        pairs = (divmod(int(keys[index]), len(self.places)) for index in np.argsort(first))
        return list(dict.fromkeys((names[code], self._scene_names[place]) for code, place in pairs))

    @functools.cached_property
    def _scene_names(self) -> list[str]:
        return [read_place(text)[0] for text in self.places.to_pylist()]

    def effects_asked_of(self, ids: Any) -> list[list[str]]:
        """The settings of effects that lead to tasks, by their ids (any sequence that Arrow takes); none for an id of
        no task."""
        if len(self.asked_values) == 1:
            return [list(self.asked_values[0])] * len(ids)
        found = pc.index_in(pa.array(ids, type=pa.string()), value_set=self.ids).to_pylist()
        return [[] if at is None else list(self.asked_values[self.asked[at]]) for at in found]
