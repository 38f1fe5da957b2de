"""What a sweep runs, by argument: the service knows no task by name."""

from __future__ import annotations

import functools
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from shift3d.settings.catalogue.reading import Catalogue, read_catalogue
from shift3d.settings.schema.config import Config
from shift3d.task.exchange import AssetsSpec, Row, TaskResult
from shift3d.task.spec import TaskSpec

if TYPE_CHECKING:
    from shift3d.sweep.planning.plan import Plan


@dataclass(frozen=True)
class TaskKind:
    """A kind of task. run and load are importable functions, since workers import them by name.

    run: (spec, assets) to a result, a pure function of both. load: what a worker loads once and passes to
    every ``run``. catalogue: settings to what there is to run on, with content hashes. preview: the same, without the
    hashes of scenes that would take long; None: catalogue takes no time. single: whether one of its tasks
    can be run by its id (``shift3d sweep NAME --task ID``). memory_mb: what a worker needs, about, in 2^20 bytes.
    prepare: what the driver makes once before workers load it, for the assets and the tasks' specs without their scene;
    None: nothing.
    """

    run: Callable[[TaskSpec, Any], TaskResult]
    load: Callable[[AssetsSpec], Any]
    catalogue: Callable[[Config], Catalogue]
    single: bool = True
    memory_mb: float = 1400.0
    preview: Callable[[Config], Catalogue] | None = None
    prepare: Callable[[AssetsSpec, Sequence[TaskSpec]], object] | None = None


def shift3d_kind() -> TaskKind:
    """The real task: place a vehicle, attack it, score what was found."""
    preview = functools.partial(read_catalogue, preview=True)
    return TaskKind(run=_run, load=_load, catalogue=read_catalogue, preview=preview, prepare=_prepare)


# The renderer and the meshes are imported where tasks run: a plan, and the driver of a sweep on Ray, need neither.
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
    """The command up to the task's id; empty where a kind's tasks cannot be run one by one."""
    if not kind.single:
        return ""
    return " ".join([*map(shlex.quote, ["shift3d", "sweep", plan.sweep, *plan.overrides]), "--task"])


def with_command(row: Row, command: str) -> Row:
    """A row of ``attempts`` whose traceback ends with how to see it again."""
    if not command:
        return row
    parts = [row["traceback"], f"reproduce: {command} {row['task_id']}"]
    return {**row, "traceback": "\n".join(part for part in parts if part)}
