"""The command that runs one task again, beside the traceback of a quarantined task."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from shift3d.sweep.planning.kind import TaskKind
    from shift3d.sweep.planning.plan import Plan
    from shift3d.task.exchange import Row


def reproduce_command(kind: TaskKind, plan: Plan) -> str:
    """The command up to the task's id; empty where a kind's tasks cannot be run one by one."""
    if not kind.single:
        return ""
    return " ".join([*map(shlex.quote, ["shift3d", "sweep", plan.sweep, *plan.overrides]), "--task"])


def with_command(row: Row, command: str) -> Row:
    """A row of ``attempts`` whose traceback ends with how to see it again."""
    if not command:
        return row
    text = row["traceback"] or ""
    return {**row, "traceback": f"{text}{chr(10) if text else ''}reproduce: {command} {row['task_id']}"}
