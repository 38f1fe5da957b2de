"""When the numbers of a sweep cannot mean much: a short search, few scenes, or no vehicle that found a place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from shift3d.sweep.planning.tasks import Tasks
from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["nothing_placed", "trial_caveat"]

PAPER_STEPS = 40
_LEAST_STEPS, _LEAST_SCENES = 10, 4


def trial_caveat(tasks: Tasks) -> str | None:
    """What to know before reading a sweep's AUCs, with the command for AUCs that mean something, or None.

    tasks: of the whole plan; of several numbers of steps the largest counts.
    """
    steps = max(group.template.attack.steps for group in tasks.groups())
    scenes = tasks.scenes()
    reasons = []
    if steps < _LEAST_STEPS:
        reasons.append(f"a search of {counted(steps, 'step')} (the paper's: {PAPER_STEPS})")
    if len(scenes) < _LEAST_SCENES:
        reasons.append(f"{counted(len(scenes), 'scene')} (at least {_LEAST_SCENES})")
    if not reasons:
        return None
    datasets = {dataset for dataset, _ in scenes}
    command = 'make sweep SWEEP=kitti ARGS="scenes.root=PATH"' if datasets == {"kitti"} else "make sweep"
    return f"A trial: these AUCs mean nothing, with {' and '.join(reasons)}. AUCs that do: {command}"


def nothing_placed(scores: pd.DataFrame, settings: Mapping[str, Any]) -> str | None:
    """That nothing fitted, what a place had to be, and which settings to widen; None where some vehicle found one.

    Args:
        scores: the table of ``final/``. settings: of the sweep's first task.
    """
    if scores.empty or not scores["status"].eq("no_placement").all():
        return None
    tasks = scores["task_id"].nunique()
    which = "its one task has" if tasks == 1 else f"all {tasks} tasks have"
    place = settings["attack"]["placement"]
    return (
        f"no vehicle found a place: {which} no score. Each tried {counted(place['attempts'], 'place')} of at least "
        f"{counted(place['min_object_points'], 'point')}, {place['min_range_m']:g} to {place['max_range_m']:g} m away, "
        f"that touch the scene ({place['contact_m']:g} m) and nothing in it ({place['overlap_m']:g} m). Widen "
        "attack.placement.min_object_points, .min_range_m, .max_range_m or .attempts, or take other scenes"
    )
