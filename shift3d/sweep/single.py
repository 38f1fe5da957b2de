"""One task of a plan, here and now: to look at its rows, or at its traceback."""

from __future__ import annotations

from shift3d.processor import configure_runtime
from shift3d.store.tables import table_from_rows
from shift3d.sweep.execution.worker import completed_rows
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import Plan


def run_single(plan: Plan, kind: TaskKind, task_id: str) -> str:
    """Run the task whose id begins with ``task_id``, and return its scores and timings as text.

    Raises: InputError: no task of the plan, or several, have such an id. Whatever the task itself raises.
    """
    task = plan.tasks.one(task_id, f"sweep {plan.sweep}")
    planned = plan.assets[task.assets]
    assets = kind.load(planned)
    configure_runtime(planned.threads)
    rows = completed_rows(task.spec, plan.sweep, kind.run(task.spec, assets))
    parts = []
    for name in ("scores", "timings"):
        frame = table_from_rows(name, rows[name]).to_pandas()
        parts.append(frame.drop(columns=["task_id", "sweep"], errors="ignore").to_string())
    return "\n\n".join(parts)
