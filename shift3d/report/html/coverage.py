"""What did not run, and what each task came to."""

from __future__ import annotations

from shift3d.report.html.document import Section, paragraph, table
from shift3d.report.html.sweep import METHODS, Sweep
from shift3d.sweep.planning.plan_view import skipped_lines

__all__ = ["coverage_section"]

_SHOWN = 20


def coverage_section(sweep: Sweep) -> Section:
    """The section: tasks planned, scored, without a score by reason, retried and given up."""
    scores, attempts, planned = sweep.scores, sweep.attempts, len(sweep.plan.tasks)
    scored = set(scores.loc[scores["score"].notna(), "task_id"])
    rest = scores[~scores["task_id"].isin(scored)]
    lines = [["planned", str(planned)], ["scored", str(len(scored))]]
    lines += [
        [f"without a score: {status}", str(count)]
        for status, count in rest.groupby("status", sort=True)["task_id"].nunique().items()
    ]
    given_up = attempts[attempts["quarantined"] & ~attempts["task_id"].isin(scores["task_id"])]
    lines.append(["quarantined", str(given_up["task_id"].nunique())])
    failed = attempts[attempts["outcome"] != "done"]
    lines.append(["attempts that failed", str(len(failed))])
    body = [table("Tasks", ["what", "tasks"], lines), _rows(sweep)]
    body += [paragraph(f"Quarantined: {row.task_id}: {row.error}"[:400]) for row in given_up.head(_SHOWN).itertuples()]
    if len(given_up) > _SHOWN:
        body.append(paragraph(f"And {len(given_up) - _SHOWN} more in final/attempts.parquet."))
    body += [paragraph(line.strip()) for line in skipped_lines(sweep.plan)]
    if given_up.empty and failed.empty and len(scored) == planned:
        body.append(paragraph("Nothing failed and nothing is missing."))
    return Section("coverage", "Failures and coverage", body)


def _rows(sweep: Sweep) -> str:
    """What rows say of the search: their status, and whether the object may stand there."""
    lines = []
    for (method, status), rows in sweep.scores.groupby(["method", "status"], sort=False):
        may = rows[["overlap_ok", "contact_ok"]].dropna()
        held = f"{float(may.astype(bool).all(axis=1).mean()):.0%}" if len(may) else "-"
        lines.append([METHODS.get(method, method), str(status).replace("_", " "), str(len(rows)), held])
    return table("Rows by method and status", ["method", "status", "rows", "constraints held"], lines)
