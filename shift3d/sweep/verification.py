"""Every solution of a finished sweep scored again: a sweep of its own, over the same tasks, in the same folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pyarrow.compute as pc

from shift3d.errors import InputError
from shift3d.settings.schema.config import LocalRunnerConfig, RayRunnerConfig
from shift3d.store.location import Location
from shift3d.store.log_entries import Commit, read_log
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import read_table, write_table
from shift3d.sweep.drive import SweepResult, run_sweep
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.results.final import FinalTables, check_segments, segments_in_plan_order, write_final
from shift3d.sweep.results.verified_scores import FOLDER


def verification_kind() -> TaskKind:
    """A task that scores another one's solutions again."""
    from shift3d.settings.catalogue.reading import read_catalogue
    from shift3d.task.follow_ups.verify import load_verify_assets, verify_task

    return TaskKind(run=verify_task, load=load_verify_assets, catalogue=read_catalogue, single=False)


def verification_plan(folder: LocationLike) -> Plan:
    """The tasks of a finished sweep that have solutions, in its order.

    Tasks of one vehicle in one scene share their baseline, which a worker scores again once: in this order they lie
    far apart, so that two workers do not begin it at the same time.

    Raises: InputError: the folder is not a sweep's, it has not finished, or nothing in it was scored.
    """
    folder = as_location(folder)
    plan = read_plan(folder)
    path = folder / "final" / "solutions.parquet"
    if not path.is_file():
        raise InputError("the sweep is not finished", where=str(folder), remedy="Run its command again: it resumes")
    read_table(folder / "final" / "scores.parquet", "scores")  # damaged, it would fail every task
    solved = pc.unique(read_table(path, "solutions")["task_id"])
    tasks = plan.tasks.select(np.flatnonzero(pc.is_in(plan.tasks.ids, value_set=solved).to_numpy(zero_copy_only=False)))
    if not len(tasks):
        raise InputError("no task has a solution", where=str(path), remedy="See status in final/scores.parquet")
    results = str((folder / "final").absolute())
    assets = tuple(dataclasses.replace(part, results=results) for part in plan.assets)
    return dataclasses.replace(plan, tasks=tasks, assets=assets)


def verify_sweep(folder: LocationLike, plan: Plan, runner: RayRunnerConfig | LocalRunnerConfig) -> SweepResult:
    """Verify what is left of a finished sweep's solutions, and put the result into its final tables.

    Exactly once, resumable and to the same bytes, as a sweep. plan: of `verification_plan`.

    Raises: InputError: as `run_sweep`; a segment of the sweep is damaged, which is found before anything runs.
    """
    folder = as_location(folder)
    check_segments(folder, read_log(folder))

    def finish(own: Location, verified: Plan, entries: Sequence[Commit]) -> FinalTables:
        for name in ("verification", "timings", "attempts"):
            write_table(own / "final" / f"{name}.parquet", segments_in_plan_order(own, entries, name, verified))
        return write_final(folder, read_plan(folder), read_log(folder))

    return run_sweep(plan, runner, verification_kind(), folder / FOLDER, finish)
