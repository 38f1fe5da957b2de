"""What was run: axes, accuracy, effects, scenes, vehicles, versions, and what it cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from shift3d.report.caveats import trial_caveat
from shift3d.report.html.document import Section, aside, paragraph, table, terms
from shift3d.report.html.sweep import Sweep
from shift3d.report.placement import nothing_placed
from shift3d.sweep.planning.tasks import TaskGroup
from shift3d.wording import counted

__all__ = ["overview"]

_SETTINGS = ("steps", "alpha", "lambda", "random_replicates", "noise_replicates", "noise_sigma", "max_shift_m")


def overview(sweep: Sweep) -> Section:
    """The section."""
    plan = sweep.plan
    caveat = None if nothing_placed(sweep.scores, plan.settings) else trial_caveat(plan.tasks)
    body = [
        *([paragraph(caveat)] if caveat else []),
        terms(_facts(sweep)),
        _axes(plan.axes),
        *_cost(sweep),
        _versions(sweep),
    ]
    return Section("run", "What was run", body)


def _facts(sweep: Sweep) -> dict[str, str]:
    plan = sweep.plan
    groups = plan.tasks.groups()
    specs = [group.template for group in groups]
    modes = _counted((group.tasks, (group.template.mode,)) for group in groups)
    asked = _counted((group.tasks, group.effects_requested) for group in groups)
    by_dataset = Counter(dataset for dataset, _ in sorted(plan.tasks.scenes()))
    attack = plan.settings.get("attack", {})
    return {
        "Sweep": f"{plan.sweep}, hash {plan.spec_hash}",
        "Tasks": f"{len(plan.tasks)}: {', '.join(f'{count} {mode}' for mode, count in modes.items())}",
        "Changed settings": ", ".join(plan.overrides) or "none",
        "Scenes": "; ".join(f"{count} of {name}" for name, count in by_dataset.items()),
        "Vehicles": ", ".join(dict.fromkeys(spec.vehicle.replace("_", " ") for spec in specs)),
        "Detectors": "; ".join(_detectors(specs)),
        "Accuracy": ", ".join(dict.fromkeys(spec.accuracy for spec in specs)),
        "Effects asked, by tasks": ", ".join(f"{name} ({count})" for name, count in asked.items()),
        "Effects that ran, by tasks": _ran(groups),
        "Attack": ", ".join(f"{name} {attack[name]}" for name in _SETTINGS if name in attack),
    }


def _detectors(specs: list[Any]) -> list[str]:
    pairs = dict.fromkeys((spec.detector, spec.scored_by) for spec in specs)
    return [f"{attacked} attacked, scored by {', '.join(by)}" for attacked, by in pairs]


def _counted(named: Iterable[tuple[int, Sequence[str]]]) -> Counter[str]:
    """How many tasks there are of each name."""
    counts: Counter[str] = Counter()
    for tasks, names in named:
        for name in names:
            counts[name] += tasks
    return counts


def _ran(groups: list[TaskGroup]) -> str:
    ran = _counted((group.tasks, group.template.effects) for group in groups)
    return ", ".join(f"{name} ({count})" for name, count in ran.items()) or "none: occlusion alone, as the paper"


def _axes(axes: dict[str, list[str]]) -> str:
    if not axes:
        return paragraph("No axis: one setting.", "missing")
    lines = [[name, str(len(values)), ", ".join(values)] for name, values in axes.items()]
    return table("Axes of the sweep", ["axis", "values", "which"], lines)


def _cost(sweep: Sweep) -> list[str]:
    timings = sweep.timings
    if timings.empty:
        return [paragraph("Cost: the sweep has no timings.", "missing")]
    tasks = timings["task_id"].nunique()
    seconds = timings.groupby("stage")["milliseconds"].sum() / 1e3
    calls = timings.groupby("stage")["calls"].sum()
    total = float(seconds.get("total", seconds.sum()))
    stages = seconds.drop("total", errors="ignore").sort_values(ascending=False)
    lines = [
        [str(stage).replace("_", " "), _seconds(value), f"{value / total:.1%}", f"{int(calls[stage])}"]
        for stage, value in stages.items()
    ]
    rest = total - float(stages.sum())
    if rest > 0:
        lines.append(["everything else", _seconds(rest), f"{rest / total:.1%}", ""])
    caption = (
        f"Time by stage over {counted(tasks, 'task')}, one thread each: {_seconds(total)} in all, "
        f"{total / tasks:.1f} s a task"
    )
    failed = sweep.attempts[sweep.attempts["outcome"] != "done"]
    wasted = f"Attempts that failed took {_seconds(float(failed['seconds'].sum()))} more." if len(failed) else ""
    return [table(caption, ["stage", "time", "share", "calls"], lines), paragraph(wasted) if wasted else ""]


def _seconds(value: float) -> str:
    if value < 120:
        return f"{value:.1f} s"
    return f"{value / 60:.1f} min" if value < 7200 else f"{value / 3600:.1f} h"


def _versions(sweep: Sweep) -> str:
    env = sweep.environment
    libraries = env.get("libraries", {})
    lines = [["shift3d", str(env.get("shift3d", "-"))], ["Python", str(env.get("python", "-"))]]
    lines += [[str(name), str(version)] for name, version in sorted(libraries.items())]
    machine = f"Processor {env.get('machine', '-')}, {env.get('cpus', '-')} cores."
    hashes = dict(pair for assets in sweep.plan.assets for pair in assets.hashes.items())
    weights = [[name, value] for name, value in sorted(hashes.items())]
    return aside(
        "Versions and weights",
        [
            paragraph(machine),
            table("Versions", ["what", "version"], lines),
            table("Weights, BLAKE2b", ["what", "hash"], weights),
        ],
    )
