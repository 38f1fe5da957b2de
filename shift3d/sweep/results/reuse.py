"""Reuse of finished tasks of another sweep: an extended grid runs only its new tasks.

A task's id covers everything that can change its result, so the same id in another folder is the same result. Rows are
copied into segments of this folder, which stays complete without the other one.

Source: our choice.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shift3d.errors import InputError
from shift3d.store.log import CommitLog, committed_rows
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import LocationLike
from shift3d.store.schemas import SWEEP_TABLES
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.spec_file import read_spec, refuse_follow_up

_TASKS_A_COMMIT = 100_000


def copy_finished_tasks(log: CommitLog, plan: Plan, other: LocationLike) -> int:
    """Commit the tasks of a plan that another sweep has finished and this one has not. Return their number.

    The other sweep may have any name, be unfinished or be running: its commits count, its quarantined tasks do not. A
    task's rows are committed with the task or not at all, so that a killed driver loses nothing.

    Raises: InputError: the folder is no sweep's, of an unreadable schema version, or damaged; as `CommitLog.commit`.
    """
    spec, entries = read_spec(other), read_log(other)
    refuse_follow_up(spec, other)
    foreign = [entry for entry in entries if entry.spec_hash != spec["spec_hash"]]
    if foreign:
        what = f"entry {foreign[0].sequence:08d}.json of its log is of another sweep"
        raise InputError(what, where=str(other), remedy="Restore it from a copy, or reuse another folder")
    finished = pa.array([task for entry in entries for task in entry.done], type=pa.string())
    there = pc.is_in(plan.tasks.ids, value_set=finished).to_numpy(zero_copy_only=False)
    here = np.zeros(len(plan.tasks), dtype=bool)
    here[plan.tasks.without(log.done())] = True
    wanted = np.flatnonzero(there & here)
    if not len(wanted):
        return 0
    tables = {name: _renamed(committed_rows(other, entries, name), plan.sweep) for name in SWEEP_TABLES}
    for start in range(0, len(wanted), _TASKS_A_COMMIT):
        ids = plan.tasks.ids.take(pa.array(wanted[start : start + _TASKS_A_COMMIT]))
        own = {name: table.filter(pc.is_in(table["task_id"], value_set=ids)) for name, table in tables.items()}
        log.commit(tuple(ids.to_pylist()), (), own)
    return len(wanted)


def _renamed(table: pa.Table, sweep: str) -> pa.Table:
    place = table.schema.get_field_index("sweep")
    if place < 0:
        return table
    names = pa.DictionaryArray.from_arrays(np.zeros(table.num_rows, dtype=np.int32), pa.array([sweep]))
    return table.set_column(place, table.schema.field(place), names.cast(pa.string()))
