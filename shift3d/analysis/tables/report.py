"""What a sweep prints at its end."""

from __future__ import annotations

from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.accuracy_cost import accuracy_cost, diagnostics, preset_table
from shift3d.analysis.tables.auc import auc_table, natural_table
from shift3d.analysis.tables.budgets import budget_table
from shift3d.analysis.tables.choices import choice_tables, reasons
from shift3d.analysis.tables.coverage import coverage_lines, stage_times
from shift3d.analysis.tables.sensors import sensor_table, transfer_table
from shift3d.analysis.variants import variants

__all__ = ["sweep_report"]


def sweep_report(sweep: Sweep) -> str:
    """AUCs, also by budget, natural shapes, shapes in other scenes, choices, what ran, its time and its accuracy."""
    parted = variants(sweep.auc, sweep.scored)
    tables = [auc_table(variant) for variant in parted]
    by_sensor, elsewhere = sensor_table(sweep.scores), transfer_table(sweep.transfers)
    further = (budget_table(parted), by_sensor, natural_table(sweep.scores), elsewhere)
    found = [table for table in further if table]
    parts = [*tables, *found, *choice_tables(sweep.choices)]
    return "\n\n".join(
        [
            *map(str, parts),
            *(["\n".join(reasons(sweep.choices))] if len(sweep.choices) else []),
            "\n".join(coverage_lines(sweep.scores, sweep.attempts, len(sweep.plan.tasks))),
            str(stage_times(sweep.timings, sweep.scores)) if len(sweep.timings) else "no timings",
            "\n".join(["What accuracy cost", *accuracy_cost(sweep.scores, sweep.timings)]),
            str(preset_table()),
            diagnostics(sweep.scores),
        ]
    )
