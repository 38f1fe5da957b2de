"""Final report of a sweep: results, coverage, time by stage, and warnings about results that mean little."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.accuracy.cost import accuracy_cost, diagnostics, preset_meanings, preset_table
from shift3d.analysis.tables.accuracy.frontier import legend
from shift3d.analysis.tables.auc import auc_table, input_words, natural_search, natural_table
from shift3d.analysis.tables.budgets import budget_table
from shift3d.analysis.tables.choices import choice_tables, reasons
from shift3d.analysis.tables.sensors import sensor_table, transfer_table
from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import variants
from shift3d.methods import METHODS
from shift3d.sweep.planning.plan import Plan
from shift3d.wording import counted


def sweep_report(sweep: Sweep) -> str:
    """Format AUCs (also by budget), natural shapes, transfers, choices, coverage, time and accuracy of a sweep."""
    parted = variants(sweep.auc, sweep.scored)
    parts = [
        *(auc_table(variant) for variant in parted),
        budget_table(parted),
        sensor_table(sweep.scores),
        natural_table(sweep.scores),
        natural_search(sweep.scores, sweep.plan.assets),
        transfer_table(sweep.transfers),
        *choice_tables(sweep.choices),
        "\n".join(reasons(sweep.choices)),
        "\n".join(coverage_lines(sweep.scores, sweep.attempts, len(sweep.plan.tasks))),
        missing_search_scenes(sweep.scores, sweep.timings),
        stage_times(sweep.timings, sweep.scores) if len(sweep.timings) else "no timings",
        "\n".join(["Audit and time by accuracy", *accuracy_cost(sweep.scores, sweep.timings)]),
        f"{preset_table()}\n{legend(preset_meanings())}",
        diagnostics(sweep.scores),
    ]
    return "\n\n".join(str(part) for part in parts if part)


PAPER_STEPS = 40
_LEAST_STEPS, _LEAST_SCENES = 10, 4
_SAME_SCORE = 1e-6


def small_sweep_warning(plan: Plan) -> str | None:
    """Return a warning if a sweep is too small for meaningful AUCs, with a command for meaningful ones, else None.

    The largest number of steps counts. Random searches and pure edits count no steps.
    """
    groups = plan.tasks.groups()
    attacks = [group.template.attack for group in groups]
    steps = max((a.steps for a in attacks if a.search != "random" and (a.steps or not a.edit)), default=PAPER_STEPS)
    scenes = plan.tasks.scenes()
    reasons = []
    if steps < _LEAST_STEPS:
        reasons.append(f"a search of {counted(steps, 'step')} (the paper's: {PAPER_STEPS})")
    if len(scenes) < _LEAST_SCENES:
        reasons.append(f"{counted(len(scenes), 'scene')} (at least {_LEAST_SCENES})")
    if not reasons:
        return None
    used = {dataset for dataset, _ in scenes}, {group.template.detector for group in groups}
    chosen = input_words(*used, plan.assets)
    return f"A trial: these AUCs mean nothing, with {' and '.join(reasons)}. For meaningful AUCs: shift3d sweep{chosen}"


def no_placement_message(scores: pd.DataFrame, settings: Mapping[str, Any]) -> str | None:
    """Return a message if no vehicle found a place, with the limits and the settings to widen, else None.

    Args: scores: the table of ``final/``. settings: settings of the sweep's first task.
    """
    if scores.empty or not scores["status"].eq("no_placement").all():
        return None
    tasks = scores["task_id"].nunique()
    which = "the one task has" if tasks == 1 else f"all {tasks} tasks have"
    place = settings["attack"]["placement"]
    return (
        f"no vehicle found a place, so {which} no score. Each task tried {counted(place['attempts'], 'place')}. "
        f"A place needs at least {counted(place['min_object_points'], 'point')} on the vehicle, a range of "
        f"{place['min_range_m']:g} to {place['max_range_m']:g} m, a scene point within {place['contact_m']:g} m of the "
        f"vehicle, and none more than {place['overlap_m']:g} m inside it. Widen attack.placement.min_object_points, "
        ".min_range_m, .max_range_m or .attempts, or choose other scenes"
    )


def unresponsive_detectors(scores: pd.DataFrame) -> str | None:
    """Return a warning that names the detectors whose score never reacts to changes of the vehicle, else None.

    scores: the table of ``final/``. Only tasks whose rows differ in their number of points on the vehicle count.
    """
    scored = scores[scores["score"].notna() & scores["object_points"].notna()]
    by_task = scored.groupby(["scored_by", "task_id"], sort=False)
    differ = by_task["object_points"].nunique() > 1
    spread = (by_task["score"].max() - by_task["score"].min())[differ]
    widest = spread.groupby("scored_by", sort=False).max()
    names = [str(name) for name in widest.index[widest <= _SAME_SCORE]]
    if not names:
        return None
    return (
        f"{' and '.join(names)}: in every task, no change of the vehicle changes the score. Does the detector see the "
        "vehicle at all? Check frame, units and range of the detector's points and boxes (docs/guides/detectors.md)"
    )


def coverage_lines(scores: pd.DataFrame, attempts: pd.DataFrame, planned: int, shown: int = 5) -> list[str]:
    """Describe the number of scored tasks and the outcome of the others. shown: number of quarantined tasks to name."""
    scored = scores.loc[scores["score"].notna(), "task_id"]
    lines = [f"{scored.nunique()} of {counted(planned, 'task')} scored"]
    without = scores[~scores["task_id"].isin(scored)]
    for status, count in without.groupby("status", sort=True)["task_id"].nunique().items():
        lines.append(f"  {count} without a score: {status}")
    quarantined = attempts[attempts["quarantined"] & ~attempts["task_id"].isin(scores["task_id"])]
    quarantined = quarantined.drop_duplicates("task_id", keep="last")  # a retried task has several rows
    if len(quarantined):
        lines.append(f"  {len(quarantined)} quarantined (tracebacks in final/attempts.parquet):")
        lines += [f"    {row.task_id}  {row.error}"[:160] for row in quarantined.head(shown).itertuples()]
        if len(quarantined) > shown:
            lines.append(f"    and {len(quarantined) - shown} more")
    left_out = attempts.loc[attempts["outcome"] == "not_loaded", "error"].drop_duplicates()
    lines += [f"  {error}" for error in left_out.head(shown)]
    if len(left_out) > shown:
        lines.append(f"  and {counted(len(left_out) - shown, 'more machine')}")
    return lines


def unscored_tasks(scores: pd.DataFrame, planned: int) -> str | None:
    """Return a caveat if some of the planned tasks have no score, else None. scores: the table of ``final/``."""
    scored = scores.loc[scores["score"].notna(), "task_id"].nunique()
    return None if scored == planned else f"{planned - scored} of {counted(planned, 'task')} have no score"


def missing_search_scenes(scores: pd.DataFrame, timings: pd.DataFrame) -> str:
    """Return a note if universal shapes were searched in fewer scenes than requested, else an empty text."""
    found = timings[timings["stage"] == "search_scenes"].set_index("task_id")["calls"]
    search = scores.drop_duplicates("task_id").set_index("task_id")["search"].loc[found.index]
    requested = search.str.extract(r"_universal(\d+)", expand=False).astype(int) - 1
    left_out = requested - found
    if not left_out.any():
        return ""
    return (
        f"{(left_out > 0).sum()} of {counted(len(found), 'universal shape')} searched in fewer scenes than requested: "
        f"{left_out.sum()} of {counted(requested.sum(), 'other scene')} had no room for the vehicle"
    )


def rows_by_status(scores: pd.DataFrame) -> Table:
    """Count rows by method and status, with the share of rows whose object satisfies the placement constraints."""
    lines = []
    for (method, status), rows in scores.groupby(["method", "status"], sort=False):
        checked = rows[["overlap_ok", "contact_ok"]].dropna()
        held = f"{checked.astype(bool).all(axis=1).mean():.0%}" if len(checked) else "-"
        lines.append([METHODS.get(method, method), str(status).replace("_", " "), str(len(rows)), held])
    return Table("Rows by method and status", ["method", "status", "rows", "constraints held"], lines)


def stage_times(timings: pd.DataFrame, scores: pd.DataFrame) -> Table:
    """Build the table of mean milliseconds and calls per task by mode and stage, with shares; one thread each."""
    modes = scores.drop_duplicates("task_id").set_index("task_id")["mode"]
    timings = timings.assign(mode=timings["task_id"].map(modes))
    tasks = timings.groupby("mode")["task_id"].nunique()
    sums = timings.groupby(["mode", "stage"], sort=False)[["milliseconds", "calls"]].sum()
    lines = []
    for mode, count in tasks.items():
        stages = sums.loc[mode].sort_values("milliseconds", ascending=False) / count
        total = stages["milliseconds"].get("total", stages["milliseconds"].sum())
        for stage in stages.itertuples():
            share = f"{stage.milliseconds / total:.0%}"
            lines.append([str(mode), str(stage.Index), f"{stage.milliseconds:.0f}", share, f"{stage.calls:.3g}"])
    return Table("Time per task", ["mode", "stage", "ms", "share", "calls"], lines)
