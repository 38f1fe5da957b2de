"""Estimate of a plan's run time before anything runs, from the times of an earlier sweep or else from shipped times.

Source: our choice.
"""

from __future__ import annotations

import json
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.compute as pc

from shift3d.analysis.tables.accuracy.cost import measured_presets
from shift3d.effects.applicability import measured_impact
from shift3d.processor import usable_cpus
from shift3d.settings.schema.config import RayRunnerConfig, RunnerConfig
from shift3d.store.log import committed_rows
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import LocationLike, as_location
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.tasks import Tasks
from shift3d.task.spec import TaskSpec
from shift3d.wording import counted, duration

# Shipped times of the parts of a task; written by ``docs/scripts/shipped.py``.
SHIPPED = Path(__file__).resolve().parent / "measured" / "task_parts.json"


@dataclass(frozen=True)
class TaskPartTimes:
    """Milliseconds of the parts of a task with one worker and one thread, as means over the tasks of some sweeps.

    source: description of these sweeps. accuracy: their preset. By mode: once_ms of a task (placement, audits, mesh),
    step_ms of a search step without the detector, scored_ms of an object that is rendered to be scored. By detector:
    descent_ms of a step (forward and backward pass), score_ms of an object. placement_ms: finding a place for a
    vehicle.
    """

    source: str
    accuracy: str
    once_ms: dict[str, float]
    step_ms: dict[str, float]
    scored_ms: dict[str, float]
    descent_ms: dict[str, float]
    score_ms: dict[str, float]
    placement_ms: float

    def of(self, spec: TaskSpec) -> float:
        """Return the milliseconds of one task without effects; unmeasured modes and detectors count as the slowest."""
        steps, objects = searched(spec)
        each_step = _or_slowest(self.step_ms, spec.mode) + _or_slowest(self.descent_ms, spec.detector)
        scored_ms = _or_slowest(self.scored_ms, spec.mode)
        each_object = scored_ms + sum(_or_slowest(self.score_ms, name) for name in spec.scored_by)
        # In each transfer scene a place is found; the shape and its baseline are scored there, except in search scenes.
        judging = max(len(spec.transfer_scenes) - spec.attack.search_scenes, 0)
        others = len(spec.transfer_scenes) * self.placement_ms + judging * 2 * each_object
        return _or_slowest(self.once_ms, spec.mode) + steps * each_step + objects * each_object + others


def searched(spec: TaskSpec) -> tuple[int, int]:
    """Count the renderings of a task's search, and the objects that the task scores."""
    attack = spec.attack
    noise = attack.noise_replicates if spec.mode != "pose" else 0
    beside = int(bool(attack.edit) and spec.mode != "pose") + attack.random_search
    searches = 1 + attack.random_search
    places = 1 + min(attack.search_scenes, len(spec.transfer_scenes))
    return searches * places * (attack.steps + 1), 2 + attack.random_replicates + beside + noise


def _or_slowest(measured: dict[str, float], name: str) -> float:
    return measured.get(name, max(measured.values()))


def shipped_parts() -> TaskPartTimes:
    """Load the shipped times."""
    return TaskPartTimes(**json.loads(SHIPPED.read_text(encoding="utf-8")))


@dataclass(frozen=True)
class RunTimeEstimate:
    """Seconds that one worker needs for all tasks together. source: origin of the estimate. guessed: number of tasks
    whose settings differ from every task measured there. longest_s: seconds of the slowest task."""

    seconds: float
    source: str
    guessed: int
    longest_s: float


def _tasks_in_logs(tasks: Tasks, folders: Sequence[LocationLike], what: Literal["done", "quarantined"]) -> np.ndarray:
    """Mask (N,) bool of tasks that any folder's log names as done or quarantined. Raises InputError: unreadable log."""
    named = {task for folder in folders for entry in read_log(folder) for task in getattr(entry, what)}
    found = np.ones(len(tasks), dtype=bool)
    found[tasks.without(named)] = False
    return found


def expected(tasks: Tasks, folders: Sequence[LocationLike]) -> RunTimeEstimate:
    """Estimate the time that one worker needs for the tasks.

    Args: folders: sweep folders, finished or not; the first one with finished tasks provides the times.

    Raises: InputError: a folder is no sweep's, or damaged.
    """
    model, kinds = _Model(), _kinds(tasks)
    each, guessed, source = [model.seconds(spec) for spec, _ in kinds], len(tasks), model.source
    for folder in folders:
        if found := _measured(folder, model):
            guessed, source = 0, f"{counted(found[()].tasks, 'task')} that ran in {as_location(folder)}"
            for number, (spec, count) in enumerate(kinds):
                level, key = next((at, key) for at, key in enumerate(_pooling_keys(spec)) if key in found)
                each[number] *= found[key].seconds / found[key].by_model
                guessed += count * (level > 0)
            break
    seconds = sum(count * one for one, (_, count) in zip(each, kinds, strict=True))
    return RunTimeEstimate(seconds, source, guessed, max(each))


def limit_line(longest_s: float, runner: RunnerConfig) -> str:
    """Return a warning if a task is expected to take more than half of its time limit, else an empty text."""
    limit_s = runner.task_timeout_s if isinstance(runner, RayRunnerConfig) else None
    if limit_s is None or longest_s <= limit_s / 2:
        return ""
    enough_s = 60 * math.ceil(4 * longest_s / 60)
    return (
        f"a task is expected to take {duration(longest_s)}; the driver stops a task after {duration(limit_s)}, retries "
        f"it once and then quarantines it (runner.task_timeout_s={limit_s:g}): give runner.task_timeout_s={enough_s}"
    )


def _kinds(tasks: Tasks) -> list[tuple[TaskSpec, int]]:
    first, kind = tasks.kinds()
    counts = np.bincount(kind, minlength=len(first))
    return [(tasks[at].spec, count) for at, count in zip(first.tolist(), counts.tolist(), strict=True)]


def _pooling_keys(spec: TaskSpec) -> list[Hashable]:
    """Return the keys under which a task's time is pooled, from all settings that affect the time down to none."""
    same = (spec.mode, spec.detector, spec.accuracy)
    return [(*same, spec.scored_by, spec.attack, len(spec.transfer_scenes), spec.effects), same, (spec.mode,), ()]


@dataclass
class _PooledTime:
    """Time of the tasks of one key: seconds of all their attempts, and seconds that the shipped times predict."""

    tasks: int = 0
    seconds: float = 0.0
    by_model: float = 0.0


def _measured(folder: LocationLike, model: _Model) -> dict[Hashable, _PooledTime]:
    """Sum the time of each key's finished tasks, without tasks that had no place and ended before the search."""
    log, tasks = read_log(folder), read_plan(folder).tasks
    attempts, scores = committed_rows(folder, log, "attempts"), committed_rows(folder, log, "scores")
    at = pc.index_in(attempts["task_id"], value_set=tasks.ids).fill_null(len(tasks)).to_numpy()
    spent = np.bincount(at, weights=attempts["seconds"].to_numpy(), minlength=len(tasks) + 1)[: len(tasks)]
    nowhere = scores["task_id"].filter(pc.equal(scores["status"], "no_placement"))
    ran = np.bincount(at[pc.equal(attempts["outcome"], "done").to_numpy()], minlength=len(tasks) + 1)[: len(tasks)] > 0
    ran &= ~pc.is_in(tasks.ids, value_set=nowhere).to_numpy(zero_copy_only=False)
    first, kind = tasks.kinds()
    counts = np.bincount(kind[ran], minlength=len(first))
    seconds = np.bincount(kind[ran], weights=spent[ran], minlength=len(first))
    found: dict[Hashable, _PooledTime] = {}
    for number in np.flatnonzero(counts).tolist():
        spec = tasks[int(first[number])].spec
        for key in _pooling_keys(spec):
            one = found.setdefault(key, _PooledTime())
            one.tasks += int(counts[number])
            one.seconds += float(seconds[number])
            one.by_model += int(counts[number]) * model.seconds(spec)
    return found


class _Model:
    """Predicted time of a task: the sum of its measured parts, plus the cost of its effects and accuracy preset."""

    def __init__(self) -> None:
        self._parts = shipped_parts()
        presets, whose = measured_presets()
        self._rendering_ms = presets["ms_median"].to_dict()
        self._impact = measured_impact()
        self.source = f"the shipped times: {self._parts.source}; presets by {whose}"

    def seconds(self, spec: TaskSpec) -> float:
        more_ms = sum(max(self._impact[name].milliseconds, 0.0) for name in spec.effects if name in self._impact)
        if {spec.accuracy, self._parts.accuracy} <= self._rendering_ms.keys():
            more_ms += self._rendering_ms[spec.accuracy] - self._rendering_ms[self._parts.accuracy]
        renderings = sum(searched(spec))
        return max(self._parts.of(spec) + renderings * more_ms, renderings) / 1e3


def run_time_lines(
    plan: Plan,
    out: LocationLike | None,
    others: Sequence[LocationLike],
    timings: Sequence[LocationLike],
    runner: RunnerConfig,
) -> str:
    """Describe a plan's remaining run: time with the runner's workers, core-hours, and a time limit that is too low.

    Args: out: folder that the sweep would write to, if known. others: folders whose results the sweep would take over.
    timings: folders that provide task times; they take precedence over `out` and `others`.

    Raises: InputError: a folder of `others` or `timings` is no sweep's, or damaged.
    """
    own = [out] if out is not None and (as_location(out) / "spec.yaml").is_file() else []
    done = _tasks_in_logs(plan.tasks, [*own, *others], "done")
    quarantined = _tasks_in_logs(plan.tasks, own, "quarantined") & ~done
    left = plan.tasks.select(np.flatnonzero(~done & ~quarantined))
    progress = f"{int(done.sum())} of {counted(len(plan.tasks), 'task')} are done already\n" if done.any() else ""
    if count := int(quarantined.sum()):
        stay = "stays out: --retry-quarantined runs it" if count == 1 else "stay out: --retry-quarantined runs them"
        progress += f"{counted(count, 'quarantined task')} {stay} again\n"
    if not len(left):
        return f"{progress}nothing is left to run"
    found = expected(left, [*timings, *own, *others])
    workers = runner.workers_on(usable_cpus()) if isinstance(runner, RayRunnerConfig) else 1
    # The plan connects to no cluster, whose size is unknown.
    here = isinstance(runner, RayRunnerConfig) and runner.address and not runner.workers
    whose = "the CPUs of this machine, not of the cluster: " if here else ""
    mean, wall = found.seconds / len(left), found.seconds / min(workers, len(left))
    text = (
        f"{progress}expected run time: {duration(wall)} with {counted(workers, 'worker')} ({whose}runner.workers=N), "
        f"{found.seconds / 3600:.3g} core-hours, for {counted(len(left), 'task')} of {duration(mean)}\n"
        f"  from {found.source}"
    )
    if found.guessed and not found.source.startswith("the shipped"):
        text += f"; the times of {counted(found.guessed, 'task')} with other settings are scaled by the shipped times"
    limit = limit_line(found.longest_s, runner)
    return f"{text}\n{limit}" if limit else text
