"""Follow-ups: sweeps over the solutions of a finished sweep, whose folder gets the resulting table."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pyarrow.compute as pc

from shift3d.errors import InputError
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.schema.config import RunnerConfig
from shift3d.store.location import Location
from shift3d.store.log_entries import Commit, read_log
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import read_final, write_table
from shift3d.sweep.drive import Finish, SweepResult, run_sweep
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.spec_file import read_spec
from shift3d.sweep.results.final import VERIFICATION, FinalTables, check_segments, segments_in_plan_order, write_final
from shift3d.task.exchange import AssetsSpec, TaskResult
from shift3d.task.spec import TaskSpec


def solved_tasks(folder: LocationLike) -> Plan:
    """Return the plan of a finished sweep's tasks that have solutions, in its order.

    Raises: InputError: the folder is not a sweep's, the sweep has not finished, or no task has a solution.
    """
    folder = as_location(folder)
    plan = read_plan(folder)
    read_final(folder, "scores")  # checked first: a damaged table would fail every task
    solved = pc.unique(read_final(folder, "solutions")["task_id"])
    tasks = plan.tasks.select(np.flatnonzero(pc.is_in(plan.tasks.ids, value_set=solved).to_numpy(zero_copy_only=False)))
    if not len(tasks):
        raise InputError("no task has a solution", where=str(folder), remedy="See status in final/scores.parquet")
    results = str((folder / "final").absolute())
    assets = tuple(dataclasses.replace(part, results=results) for part in plan.assets)
    return dataclasses.replace(plan, tasks=tasks, assets=assets)


def follow_up_kind(run: Callable[[TaskSpec, Any], TaskResult], load: Callable[[AssetsSpec], Any]) -> TaskKind:
    """Return the kind of a task that uses another task's solutions. run, load: see `TaskKind`."""
    return TaskKind(run=run, load=load, catalogue=read_catalogue, single=False)


def follow_up_tables(table: str) -> Finish:
    """Return the function that writes a table, timings and attempts into ``final/`` of the follow-up's folder."""

    def finish(own: Location, plan: Plan, entries: Sequence[Commit]) -> FinalTables:
        names = (table, "timings", "attempts")
        tables = {name: segments_in_plan_order(own, entries, name, plan) for name in names}
        for name, found in tables.items():
            write_table(own / "final" / f"{name}.parquet", found)
        return FinalTables(tables)

    return finish


def follow_up(
    folder: Location, plan: Plan, runner: RunnerConfig, kind: TaskKind, own: Location, table: str
) -> SweepResult:
    """Run the remaining tasks of a follow-up in the folder `own`, and write its table into ``final/`` of the sweep.

    Like a sweep, it runs each task exactly once, and resumes to the same bytes. folder: of the sweep. plan: of
    `solved_tasks`.
    Raises: InputError as `run_sweep`, or if the follow-up was begun when other tasks of its sweep had solutions.
    """
    if (own / "spec.yaml").is_file() and read_spec(own)["spec_hash"] != plan.spec_hash:
        what = "was begun before further tasks of the sweep had solutions"
        raise InputError(what, str(own), "Remove this folder, which is made again, and run the same command")
    result = run_sweep(plan, runner, kind, own, follow_up_tables(table))
    if result.final is not None:
        write_table(folder / "final" / f"{table}.parquet", result.final.tables[table])
    return result


def verify_sweep(folder: LocationLike, plan: Plan, runner: RunnerConfig) -> SweepResult:
    """Verify the remaining solutions of a finished sweep, and add the result to its final tables.

    plan: of `solved_tasks`.
    Raises: InputError: as `follow_up`; a segment of the sweep is damaged, which is checked before any task runs.
    """
    from shift3d.task.follow_ups.verify import load_verify_assets, verify_task

    folder, kind = as_location(folder), follow_up_kind(verify_task, load_verify_assets)
    check_segments(folder, read_log(folder))
    result = follow_up(folder, plan, runner, kind, folder / VERIFICATION, "verification")
    if result.final is None:
        return result
    return dataclasses.replace(result, final=write_final(folder, read_plan(folder), read_log(folder)))


def measure_patterns(folder: LocationLike, runner: RunnerConfig) -> SweepResult:
    """Measure the meshes of a finished sweep's remaining solutions, and write ``final/patterns.parquet``.

    Raises: InputError as `follow_up` and `solved_tasks`.
    """
    from shift3d.task.follow_ups.patterns import patterns_task
    from shift3d.task.follow_ups.verify import load_verify_assets

    folder, kind = as_location(folder), follow_up_kind(patterns_task, load_verify_assets)
    return follow_up(folder, solved_tasks(folder), runner, kind, folder / "patterns", "patterns")
