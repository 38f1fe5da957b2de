"""Tasks of a plan as columns: a million take a few tens of megabytes, and processes share them without a copy."""

from __future__ import annotations

import functools
import json
from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shift3d.errors import InputError
from shift3d.sweep.planning.task_ids import TaskScene, read_task_scene, spec_in_scene
from shift3d.task.spec import TaskSpec
from shift3d.wording import counted

Value = TypeVar("Value", bound=Hashable)


def distinct_with_indices(values: Iterable[Value]) -> tuple[list[Value], np.ndarray]:
    """Return the distinct values in order of first appearance, and the index of each value among them, (N,) int64."""
    places: dict[Value, int] = {}
    found = np.array([places.setdefault(value, len(places)) for value in values], dtype=np.int64)
    return list(places), found


@dataclass(frozen=True)
class PlannedTask:
    """Task, and the index of its assets in ``Plan.assets``.

    effects_requested: settings of effects that lead to this task, one or more: "auto", "none", or names joined by +.
    """

    spec: TaskSpec
    assets: int
    effects_requested: tuple[str, ...] = ("none",)


@dataclass(frozen=True)
class TaskGroup:
    """Tasks that differ only in their scene. template: their spec without the scene. tasks: number of tasks."""

    template: TaskSpec
    effects_requested: tuple[str, ...]
    tasks: int


@dataclass(frozen=True, eq=False)
class Tasks(Sequence[PlannedTask]):
    """Tasks in plan order. ``tasks[i]`` is made on access; a slice is Tasks again.

    The columns are Arrow and NumPy buffers, which pickle (protocol 5) passes out of band: Ray's object store holds them
    once for all workers of a machine, so that a worker gets the tasks once and only positions with each call.

    templates: specs without their scene. task_scenes: JSON, see `task_ids.task_scene_json`. template, task_scene,
    assets, requested: int32, of each task: indices into templates, task_scenes, ``Plan.assets`` and requested_values.
    ids: Arrow strings.

    Source: our choice.
    """

    templates: tuple[TaskSpec, ...]
    task_scenes: pa.Array
    template: np.ndarray
    task_scene: np.ndarray
    assets: np.ndarray
    requested: np.ndarray
    requested_values: tuple[tuple[str, ...], ...]
    ids: pa.Array

    def __len__(self) -> int:
        return len(self.template)

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
        task_scene = read_task_scene(self.task_scenes[int(self.task_scene[index])].as_py())
        spec = spec_in_scene(self.templates[self.template[index]], task_scene, self.ids[index].as_py())
        return PlannedTask(spec, int(self.assets[index]), self.requested_values[self.requested[index]])

    def __iter__(self) -> Iterator[PlannedTask]:
        return (self[index] for index in range(len(self)))

    def __eq__(self, other: object) -> bool:
        """True if both have the same tasks in the same order, with the same assets and requested effects."""
        if not isinstance(other, Tasks):
            return NotImplemented
        same = self.ids.equals(other.ids) and np.array_equal(self.assets, other.assets)
        return same and self.effects_requested_of(self.ids) == other.effects_requested_of(other.ids)

    __hash__ = None  # type: ignore[assignment]

    def select(self, positions: Sequence[int] | np.ndarray) -> Tasks:
        """Return the tasks at the positions, in that order. Raises IndexError beyond the last task."""
        chosen = np.asarray(positions, dtype=np.int64)
        columns = {name: getattr(self, name)[chosen] for name in ("template", "task_scene", "assets", "requested")}
        return replace(self, **columns, ids=self.ids.take(pa.array(chosen)))

    def starting_with(self, prefix: str) -> Tasks:
        """Return the tasks whose id begins with ``prefix``."""
        return self.select(np.flatnonzero(pc.starts_with(self.ids, prefix).to_numpy(zero_copy_only=False)))

    def one(self, prefix: str, where: str) -> PlannedTask:
        """Return the one task whose id begins with ``prefix``. where: for the error. Raises InputError otherwise."""
        found = self.starting_with(prefix)
        if len(found) != 1:
            what = f"{counted(len(found), 'task')} with an id that begins with {prefix!r}"
            raise InputError(what, where, "Take one of final/scores.parquet, or list them: shift3d plan NAME --tasks")
        return found[0]

    def without(self, ids: Collection[str]) -> np.ndarray:
        """Return the positions of the tasks whose id is not in ``ids``, in order."""
        found = pc.is_in(self.ids, value_set=pa.array(list(ids), type=pa.string()))
        return np.flatnonzero(~found.to_numpy(zero_copy_only=False))

    def groups(self) -> list[TaskGroup]:
        """Return the tasks grouped by all but their scene, with counts, in the order of each group's first task."""
        key = self.template.astype(np.int64) * len(self.requested_values) + self.requested
        keys, first, counts = np.unique(key, return_index=True, return_counts=True)
        found = []
        for index in np.argsort(first):
            template, requested = divmod(int(keys[index]), len(self.requested_values))
            found.append(TaskGroup(self.templates[template], self.requested_values[requested], int(counts[index])))
        return found

    def kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """Group the tasks that differ only in their scenes, and not in the number of scenes of transfers.

        Returns: the position of each kind's first task, ascending, and the kind of each task.
        """
        others = np.array([len(others) for *_, others in self._scenes], dtype=np.int64)[self.task_scene]
        key = self.template.astype(np.int64) * (int(others.max(initial=0)) + 1) + others
        _, first, kind = np.unique(key, return_index=True, return_inverse=True)
        order = np.argsort(first)
        return first[order], np.argsort(order)[kind]

    @functools.cached_property
    def _scenes(self) -> list[TaskScene]:
        return [read_task_scene(text) for text in self.task_scenes.to_pylist()]

    def scenes(self) -> list[tuple[str, str]]:
        """Return the scenes of the tasks as (data set, name), in the order of their first task."""
        names, dataset = distinct_with_indices(template.dataset for template in self.templates)
        keys, first = np.unique(dataset[self.template] * len(self.task_scenes) + self.task_scene, return_index=True)
        pairs = (divmod(int(keys[index]), len(self.task_scenes)) for index in np.argsort(first))
        return list(dict.fromkeys((names[code], self._scenes[task_scene][0]) for code, task_scene in pairs))

    def scene_names(self) -> set[str]:
        """Return the names of the scenes of the tasks, and of the scenes that their shapes are put into."""
        return {name for own, _, others in self._scenes for name in (own, *(other.scene for other in others))}

    def ambiguous_scenes(self) -> list[tuple[str, str]]:
        """Return (data set, name) of scenes with equal name and `scene_arguments` but different content, such as frames
        of two folders, in the order of their first task. Unknown contents are ignored."""
        made, kind = distinct_with_indices(
            (t.dataset, json.dumps(t.scene_arguments, sort_keys=True)) for t in self.templates
        )
        known, scene = distinct_with_indices(scene[:2] for scene in self._scenes)
        keys, first = np.unique(kind[self.template] * len(known) + scene[self.task_scene], return_index=True)
        contents: dict[tuple[int, str], set[str]] = {}
        for at, number in (divmod(key, len(known)) for key in keys[np.argsort(first)].tolist()):
            name, content = known[number]
            contents.setdefault((at, name), set()).add(content)
        alike = [(made[at][0], name) for (at, name), hashes in contents.items() if len(hashes - {""}) > 1]
        return list(dict.fromkeys(alike))

    def positions_of(self, ids: Any, where: str) -> np.ndarray:
        """Return the position of each task, by id (any sequence that Arrow takes).

        where: folder or file that the ids are from, for the error. Raises InputError: a task that the plan lacks.
        """
        found = pc.index_in(pa.array(ids, type=pa.string()), value_set=self.ids)
        if found.null_count:
            what = f"{counted(found.null_count, 'row')} of tasks that the plan does not have"
            raise InputError(what, where, "Restore the folder from a copy, or run the sweep in another one")
        return np.asarray(found, dtype=np.int64)

    def effects_requested_of(self, ids: Any) -> list[list[str]]:
        """Return the effect settings that lead to tasks of tables in ``final/``, by id. See `positions_of`."""
        return [list(self.requested_values[number]) for number in self.requested[self.positions_of(ids, "final")]]


def merged_settings(tasks: Tasks, within_data_set: bool = False) -> list[str]:
    """Return the settings with several values that an AUC averages over.

    within_data_set: settings that vary within a data set, which no table column separates. Replicates and seeds are
    meant to be averaged and are excluded.
    """
    seen: dict[tuple[object, ...], dict[str, list[Any]]] = {}
    for group in tasks.groups():
        spec = group.template
        scenes = tuple(spec.scene_arguments.get(name) for name in _OF_A_DATA_SET)
        dataset = spec.dataset if within_data_set else None
        key = (spec.vehicle, dataset, *scenes, spec.mode, spec.lambda_, spec.alpha, spec.detector, spec.accuracy)
        for requested in group.effects_requested:
            values = seen.setdefault((*key, spec.search, requested), {})
            for name, value in _without_column(spec).items():
                if value not in values.setdefault(name, []):
                    values[name].append(value)
    return list(dict.fromkeys(name for values in seen.values() for name in values if len(values[name]) > 1))


def setting_values(spec: TaskSpec, names: Collection[str]) -> dict[str, Any]:
    """Return the values of the named settings of `merged_settings` that the task has."""
    return {name: value for name, value in _without_column(spec).items() if name in names}


_OF_A_DATA_SET = ("kind", "sensor", "beams")
_OF_EVERY_SCENE = (*_OF_A_DATA_SET, "seed", "count", "start", "root", "names", "split")
"""Settings that select scenes or say what kind they are; the columns hold data set and scene."""


def _without_column(spec: TaskSpec) -> dict[str, Any]:
    """Return the settings of a template that no table column holds, by name."""
    own = ("search", "space_hash", "budget_rule")
    attack = {name: value for name, value in vars(spec.attack).items() if name not in own}
    detector = {name: value for name, value in spec.accuracy_settings.items() if name == "detector"}
    render = {name: value for name, value in spec.accuracy_settings.items() if name not in detector}
    placement = {name: value for name, value in vars(spec.placement).items() if not name.startswith("sector_")}
    return {
        "vehicle": (spec.vehicle_hash, spec.decoder_hash),
        "detector.weights": sorted(spec.detector_hashes.items()),
        "naturalness": spec.reference_hash,
        **{f"attack.{name}": value for name, value in attack.items()},
        **{f"attack.placement.{name}": value for name, value in placement.items()},
        **{f"accuracy.{name}": value for name, value in detector.items()},
        **{f"accuracy.render.{name}": value for name, value in render.items()},
        **{f"effects.{name}": value for name, value in spec.effect_settings.items()},
        **{f"scenes.{name}": value for name, value in spec.scene_arguments.items() if name not in _OF_EVERY_SCENE},
    }
