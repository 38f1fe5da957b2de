"""When the numbers of a sweep cannot mean much: too short a search, or too few scenes."""

from __future__ import annotations

from shift3d.sweep.planning.tasks import Tasks
from shift3d.wording import counted

__all__ = ["trial_caveat"]

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
