"""Sections about the run: settings, versions, chosen hyper-parameters, time, failures and missing results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from shift3d.analysis.html.blocks import Block, Collapsible, Items, Paragraph, Terms, missing
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.choices import choice_tables, reasons
from shift3d.analysis.tables.coverage import coverage_lines, rows_by_status, stage_times
from shift3d.analysis.tables.table import Table
from shift3d.sweep.planning.plan_view import skipped_lines
from shift3d.sweep.results.hyperparameters import NEARLY_EQUAL
from shift3d.wording import counted, duration

_RULE = (
    "The paper's rules: alpha has the lowest AUC of the solutions. lambda, for each vehicle, has the lowest mean "
    f"adversarial loss; of several within {NEARLY_EQUAL:.0%} of the lowest loss, the largest lambda is chosen (the "
    "paper says 'very similar' and gives no number). Only scenes with a score under every candidate count."
)


def choices(sweep: Sweep) -> list[Block]:
    """Build the section of choices: one table per parameter, one sentence per choice."""
    if sweep.choices.empty:
        return [missing("This sweep compares no two values of alpha or lambda.")]
    why = Collapsible("Reason for each choice", [Items(reasons(sweep.choices))])
    return [Paragraph(_RULE), *choice_tables(sweep.choices), why]


def coverage(sweep: Sweep) -> list[Block]:
    """Build the section of coverage: scored tasks, unscored ones by reason, quarantined tasks, and failed attempts."""
    planned = len(sweep.plan.tasks)
    lines = [line.strip() for line in coverage_lines(sweep.scores, sweep.attempts, planned, shown=20)]
    # A lost worker or machine ends one call; each task of the call has a row with the call's start and duration.
    failed = sweep.attempts[sweep.attempts["outcome"] != "done"].drop_duplicates(["worker", "started_unix_s"])
    if len(failed):
        lines.append(f"{counted(len(failed), 'attempt')} failed and took {failed['seconds'].sum():.0f} s")
    lines += [line.strip() for line in skipped_lines(sweep.plan)]
    complete = len(lines) == 1 and sweep.scored["task_id"].nunique() == planned
    lead = "No attempt failed, and no score is missing." if complete else "Missing scores and failed attempts:"
    rows = Collapsible("Rows by method and status", [rows_by_status(sweep.scores)])
    return [Paragraph(lead), Items(lines), rows]


_SETTINGS = (
    *("steps", "alpha", "lambda", "random_replicates", "noise_replicates", "noise_sigma", "max_shift_m"),
    "detection_radius_m",
)


def overview(sweep: Sweep) -> list[Block]:
    """Build the section of settings, axes, cost and versions."""
    return [Terms(_facts(sweep)), _axes(sweep.plan.axes), *_cost(sweep), _versions(sweep)]


def _facts(sweep: Sweep) -> dict[str, str]:
    plan = sweep.plan
    groups = plan.tasks.groups()
    specs = [group.template for group in groups]
    modes = _counts((group.tasks, (group.template.mode,)) for group in groups)
    requested = _counts((group.tasks, group.effects_requested) for group in groups)
    ran = _counts((group.tasks, group.template.effects) for group in groups)
    pairs = dict.fromkeys((spec.detector, spec.scored_by) for spec in specs)
    by_dataset = Counter(dataset for dataset, _ in sorted(plan.tasks.scenes()))
    attack = plan.common_settings.get("attack", {})
    return {
        "Sweep": f"{plan.sweep}, hash {plan.spec_hash}",
        "Tasks": f"{len(plan.tasks)}: {', '.join(f'{count} {mode}' for mode, count in modes.items())}",
        "Changed settings": ", ".join(plan.overrides) or "none",
        "Scenes": "; ".join(f"{count} of {name}" for name, count in by_dataset.items()),
        "Vehicles": ", ".join(dict.fromkeys(spec.vehicle.replace("_", " ") for spec in specs)),
        "Detectors": "; ".join(f"{attacked} attacked, scored by {', '.join(by)}" for attacked, by in pairs),
        "Accuracy": ", ".join(dict.fromkeys(spec.accuracy for spec in specs)),
        "Effects requested (tasks)": ", ".join(f"{name} ({count})" for name, count in requested.items()),
        "Effects that ran (tasks)": ", ".join(f"{name} ({count})" for name, count in ran.items())
        or "none: occlusion only, as in the paper",
        "Attack": ", ".join(f"{name} {attack[name]}" for name in _SETTINGS if name in attack) or "see the axes",
    }


def _counts(named: Iterable[tuple[int, Sequence[str]]]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for tasks, names in named:
        counts.update(dict.fromkeys(names, tasks))
    return counts


def _axes(axes: dict[str, list[str]]) -> Block:
    if not axes:
        return missing("No axis: the sweep varies no setting.")
    lines = [[name, str(len(values)), ", ".join(values)] for name, values in axes.items()]
    return Table("Axes of the sweep", ["axis", "number", "values"], lines)


def _cost(sweep: Sweep) -> list[Block]:
    timings = sweep.timings
    if timings.empty:
        return [missing("The sweep has no timings.")]
    tasks = timings["task_id"].nunique()
    seconds = float(timings.loc[timings["stage"] == "total", "milliseconds"].sum()) / 1e3
    text = (
        f"{counted(tasks, 'task')} took {duration(seconds)} on one thread each, {duration(seconds / tasks)} per task."
    )
    return [Paragraph(text), Collapsible("Time by stage", [stage_times(timings, sweep.scores)])]


def _versions(sweep: Sweep) -> Collapsible:
    env = sweep.environment
    lines = [["shift3d", str(env.get("shift3d", "-"))], ["Python", str(env.get("python", "-"))]]
    lines += [[str(name), str(version)] for name, version in sorted(env.get("libraries", {}).items())]
    processor = f"{env.get('machine', '-')}, {env.get('instructions', 'unknown instructions')}"
    machine = f"Processor of the driver: {processor}, {env.get('cpus', '-')} cores."
    weights = sorted({pair for assets in sweep.plan.assets for pair in assets.hashes.items()})
    tables = [
        Table("Versions", ["component", "version"], lines),
        Table("Weights, BLAKE2b", ["name", "hash"], [list(pair) for pair in weights]),
    ]
    return Collapsible("Versions and weights", [Paragraph(machine), *tables])
