"""Text view of a plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from shift3d.sweep.planning.effect_choices import effect_table
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.tasks import Tasks, merged_settings, setting_values
from shift3d.wording import counted

_SHOWN = 20
_USERS = {
    "alpha": ("search", ("descent",)),
    "selection_window": ("search", ("descent",)),
    "rate": ("search", ("expectation",)),
    "placements": ("search", ("expectation",)),
    "starts": ("search", ("expectation",)),
    "components": ("space", ("pca", "family")),
}
"""Setting of an attack to the setting that decides whether a task uses it, and the values that do."""
_READABLE = ("attack.", "accuracy.", "effects.", "scenes.")


def plan_summary(plan: Plan) -> str:
    """Return the numbers of tasks, vehicles and scenes, and the effects of the scenes."""
    groups = plan.tasks.groups()
    vehicles = len({group.template.vehicle for group in groups})
    scenes, looked_at = len(plan.tasks.scenes()), len(plan.tasks.scene_names())
    modes: Counter[str] = Counter()
    for group in groups:
        modes[group.template.mode] += group.tasks
    by_mode = ", ".join(f"{count} {mode}" for mode, count in sorted(modes.items(), reverse=True))
    size = ", its small size" if plan.settings.get("size") == "small" else ""
    counts = f"sweep {plan.sweep}{size}: {counted(len(plan.tasks), 'task')} ({by_mode}) of "
    counts += f"{counted(vehicles, 'vehicle')} in {counted(scenes, 'scene')}"
    lines = [*plan.notes, *merged_lines(plan.tasks), *idle_lines(plan.tasks), *skipped_lines(plan)]
    return "\n".join([counts, effect_table(plan.effects, looked_at), *lines])


def merged_lines(tasks: Tasks) -> list[str]:
    """Return lines on the settings that the printed AUCs average over, and whether a table column separates their
    values; and on scenes that no column separates."""
    mixed = merged_settings(tasks, within_data_set=True)
    by_dataset = [name for name in merged_settings(tasks) if name not in mixed]
    lines = [(mixed, "no table column separates"), (by_dataset, "the column dataset separates")]
    found = [f"AUCs average over {' and '.join(names)}: {which} their values" for names, which in lines if names]
    if alike := tasks.ambiguous_scenes():
        first = ", ".join(f"{dataset}/{scene}" for dataset, scene in alike[:3])
        found.append(
            f"{counted(len(alike), 'scene name')} (e.g. {first}) {'refers' if len(alike) == 1 else 'refer'} to several "
            "frames: tables, intervals and scene counts treat these frames as one scene. Give each frame its own name"
        )
    return found


def idle_lines(tasks: Tasks) -> list[str]:
    """Return lines on the axes that searches do not use, whose tasks repeat each other with other random numbers."""
    found: dict[tuple[str, str], set[float]] = {}
    for group in tasks.groups():
        attack = vars(group.template.attack) | {"alpha": group.template.alpha}
        for name, (owner, users) in _USERS.items():
            if attack[owner] not in users:
                found.setdefault((name, f"attack.{owner}={attack[owner]}"), set()).add(attack[name])
    return [
        f"{counted(len(values), 'value')} of attack.{name} make equal tasks under {owner}, which does not use it: "
        "results differ by random numbers alone"
        for (name, owner), values in found.items()
        if len(values) > 1
    ]


def skipped_lines(plan: Plan) -> list[str]:
    """Return lines on the unreadable scenes that are left out, with reasons."""
    if not plan.skipped:
        return []
    lines = [f"{counted(len(plan.skipped), 'scene')} left out as unreadable (scenes.skip_bad):"]
    lines += [f"  {name}: {why}" for name, why in list(plan.skipped.items())[:_SHOWN]]
    more = len(plan.skipped) - _SHOWN
    return lines if more <= 0 else [*lines, f"  and {more} more, in final/skipped_scenes.parquet"]


def plan_lines(plan: Plan) -> Iterator[str]:
    """Yield one line per task: id, vehicle, scene, mode and the settings that vary."""
    width = max(len(group.template.vehicle) for group in plan.tasks.groups())
    scene_width = max(len(scene) for _, scene in plan.tasks.scenes())
    searches = len({group.template.search for group in plan.tasks.groups()}) > 1
    # Hashes of vehicles and weights mean nothing to a reader.
    names = [name for name in merged_settings(plan.tasks) if name.startswith(_READABLE)]
    for task in plan.tasks:
        spec = task.spec
        weight = "" if spec.lambda_ is None else f"lambda {spec.lambda_:g}"
        effects = ", ".join(spec.effects) or "no effects"
        further = [spec.search] * searches + [f"{name}={value}" for name, value in setting_values(spec, names).items()]
        yield (
            f"{spec.task_id}  {spec.vehicle:<{width}}  {spec.scene:<{scene_width}}  {spec.mode:<5}  "
            f"{weight:<10}  alpha {spec.alpha:g}  {spec.accuracy}  {'  '.join([effects, *further])}"
        )
