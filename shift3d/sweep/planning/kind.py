"""Kind of task that a sweep runs, passed as an argument: the sweep service knows no task by name."""

from __future__ import annotations

import functools
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from shift3d import processor
from shift3d.settings.catalogue.reading import Catalogue, read_catalogue
from shift3d.settings.schema.config import Config
from shift3d.task.exchange import AssetsSpec, Row, TaskResult
from shift3d.task.spec import TaskSpec

if TYPE_CHECKING:
    from shift3d.sweep.planning.plan import Plan


@dataclass(frozen=True)
class TaskKind:
    """Kind of task. run and load are importable functions, since workers import them by name.

    run: pure function of (spec, assets) that returns a result. load: loads the assets of all tasks, once per worker.
    catalogue: lists the scenes, vehicles and detectors of settings, with content hashes. preview: the same, without
    scene hashes that take long; None: catalogue is fast. single: a task can be run by its id (``shift3d sweep NAME
    --task ID``). memory_mb: approximate memory of a worker, in 2^20 bytes. prepare: run once by the driver before
    workers load, with the assets and the tasks' specs without their scene; None: nothing. instructions: describes the
    instructions of this processor that decide the tasks' rounding; a worker calls it before it loads.
    """

    run: Callable[[TaskSpec, Any], TaskResult]
    load: Callable[[AssetsSpec], Any]
    catalogue: Callable[[Config], Catalogue]
    single: bool = True
    memory_mb: float = 1400.0
    preview: Callable[[Config], Catalogue] | None = None
    prepare: Callable[[AssetsSpec, Sequence[TaskSpec]], object] | None = None
    instructions: Callable[[], str] = processor.instructions


def shift3d_kind() -> TaskKind:
    """Return the kind of the attack task: place a vehicle, attack it, score the result."""
    preview = functools.partial(read_catalogue, preview=True)
    return TaskKind(run=_run, load=_load, catalogue=read_catalogue, preview=preview, prepare=_prepare)


# Late imports: a plan, and the driver of a sweep on Ray, need neither the renderer nor the meshes.
def _run(spec: TaskSpec, assets: Any) -> TaskResult:
    from shift3d.task.run import run_task

    return run_task(spec, assets)


def _load(spec: AssetsSpec) -> Any:
    from shift3d.task.assets import load_assets

    return load_assets(spec)


def _prepare(spec: AssetsSpec, templates: Sequence[TaskSpec]) -> None:
    from shift3d.task.assets import prepare_naturalness

    prepare_naturalness(spec, templates)


def reproduce_command(kind: TaskKind, plan: Plan) -> str:
    """Return the command that runs one task, up to the task id; "" if tasks of the kind cannot run one by one."""
    if not kind.single:
        return ""
    return " ".join([*map(shlex.quote, ["shift3d", "sweep", plan.sweep, *plan.overrides]), "--task"])


def with_command(row: Row, command: str) -> Row:
    """Return a row of ``attempts`` whose traceback ends with the command that reproduces it."""
    if not command:
        return row
    parts = [row["traceback"], f"reproduce: {command} {row['task_id']}"]
    return {**row, "traceback": "\n".join(part for part in parts if part)}
