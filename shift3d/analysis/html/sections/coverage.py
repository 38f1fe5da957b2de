"""What ran and what did not, what each task came to, and where the time went."""

from __future__ import annotations

from shift3d.analysis.html.blocks import Fold, Items, Paragraph, Section
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.coverage import coverage_lines, rows_by_status
from shift3d.sweep.planning.plan_view import skipped_lines
from shift3d.wording import counted

__all__ = ["coverage"]


def coverage(sweep: Sweep) -> Section:
    """The section: tasks scored, without a score by reason, quarantined, and attempts that failed."""
    planned = len(sweep.plan.tasks)
    lines = [line.strip() for line in coverage_lines(sweep.scores, sweep.attempts, planned, shown=20)]
    failed = sweep.attempts[sweep.attempts["outcome"] != "done"]
    if len(failed):
        lines.append(f"{counted(len(failed), 'attempt')} failed, in {failed['seconds'].sum():.0f} s")
    lines += [line.strip() for line in skipped_lines(sweep.plan)]
    complete = len(lines) == 1 and sweep.scored["task_id"].nunique() == planned
    lead = "Nothing failed and nothing is missing." if complete else "What is missing, and why."
    rows = Fold("Rows by method and status", [rows_by_status(sweep.scores)])
    return Section("coverage", "Failures and coverage", [Paragraph(lead), Items(lines), rows])
