"""What is done with a finished sweep's solutions, task by task: a sweep of its own, whose table its folder gets."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shift3d.settings.schema.config import LocalRunnerConfig, RayRunnerConfig
from shift3d.store.location import Location
from shift3d.store.log_entries import Commit
from shift3d.store.tables import write_table
from shift3d.sweep.drive import SweepResult, run_sweep
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.results.final import FinalTables, segments_in_plan_order

Finish = Callable[[Location, Plan, Sequence[Commit]], FinalTables]


def follow_up_tables(table: str) -> Finish:
    """What writes a table, timings and attempts into the ``final/`` of the folder that they were made in."""

    def finish(own: Location, plan: Plan, entries: Sequence[Commit]) -> FinalTables:
        names = (table, "timings", "attempts")
        tables = {name: segments_in_plan_order(own, entries, name, plan) for name in names}
        for name, found in tables.items():
            write_table(own / "final" / f"{name}.parquet", found)
        return FinalTables(tables)

    return finish


def follow_up(
    folder: Location, plan: Plan, runner: RayRunnerConfig | LocalRunnerConfig, kind: TaskKind, own: Location, table: str
) -> SweepResult:
    """Run what is left of it in a folder of its own, and put its table into the sweep's ``final/``.

    Exactly once, resumable and to the same bytes, as a sweep. folder: the sweep's. plan: of `verification_plan`.
    Raises: InputError as `run_sweep`.
    """
    result = run_sweep(plan, runner, kind, own, follow_up_tables(table))
    if result.final is not None:
        write_table(folder / "final" / f"{table}.parquet", result.final.tables[table])
    return result
