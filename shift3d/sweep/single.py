"""One task of a plan, here and now: to look at its rows, or at its traceback."""

from __future__ import annotations

from shift3d.errors import InputError
from shift3d.processor import configure_runtime
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.worker import completed_rows
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan
from shift3d.wording import counted


def run_single(plan: Plan, kind: TaskKind, task_id: str) -> str:
    """Run the task whose id begins with ``task_id``, and return its scores and timings as text.

    Raises: InputError: no task of the plan, or several, have such an id. Whatever the task itself raises.
    """
    found = plan.tasks.starting_with(task_id)
    if len(found) != 1:
        raise InputError(
            f"{counted(len(found), 'task')} with an id that begins with {task_id!r}",
            where=f"sweep {plan.sweep}",
            remedy="shift3d plan lists the ids",
        )
    planned = plan.assets[found[0].assets]
    assets = kind.load(planned)
    configure_runtime(planned.threads)
    rows = completed_rows(found[0].spec, plan.sweep, kind.run(found[0].spec, assets))
    parts = []
    for name in ("scores", "timings"):
        frame = table_from_rows(name, rows[name]).to_pandas()
        parts.append(frame.drop(columns=["task_id", "sweep"], errors="ignore").to_string())
    return "\n\n".join(parts)
