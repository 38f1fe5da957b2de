"""What the parts of a task take, measured: from the timings of finished sweeps, and as they ship.

``python -m shift3d.analysis.forecast.task_parts OUT ... > shift3d/analysis/measured/task_parts.json``: each OUT is a
finished sweep's folder, of one accuracy preset.

Source: our choice.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from shift3d.analysis.results import read_sweep
from shift3d.errors import InputError
from shift3d.task.spec import TaskSpec
from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["SHIPPED", "TaskParts", "measured_parts", "shipped_parts"]

SHIPPED = Path(__file__).resolve().parent.parent / "measured" / "task_parts.json"
"""What they took when this version was made."""

_STEP, _DESCENT = ("render", "constraints"), ("detector", "backward")
_SCORED_BY = "scored_by_"


@dataclass(frozen=True)
class TaskParts:
    """Milliseconds of one worker with one thread, means over the tasks of some sweeps.

    source: which sweeps. accuracy: their preset. By mode: once_ms of a task (placement, audits, the mesh), step_ms of a
    search's step without the detector, scored_ms of an object that is rendered to be scored. By detector: descent_ms
    of a step, its forward and backward pass; score_ms of an object. placement_ms: of finding a place for a vehicle.
    """

    source: str
    accuracy: str
    once_ms: dict[str, float]
    step_ms: dict[str, float]
    scored_ms: dict[str, float]
    descent_ms: dict[str, float]
    score_ms: dict[str, float]
    placement_ms: float

    def of(self, spec: TaskSpec) -> float:
        """Milliseconds of one task at this accuracy, without effects. Detectors not measured count as the slowest."""
        steps, objects = searched(spec)
        each_step = self.step_ms[spec.mode] + _or_slowest(self.descent_ms, spec.detector)
        each_object = self.scored_ms[spec.mode] + sum(_or_slowest(self.score_ms, name) for name in spec.scored_by)
        # In another scene a place is found, and the shape and its baseline are scored there.
        others = len(spec.transfer_scenes) * (self.placement_ms + 2 * each_object)
        return self.once_ms[spec.mode] + steps * each_step + objects * each_object + others


def searched(spec: TaskSpec) -> tuple[int, int]:
    """Renderings of a task's search, and of the objects that it scores."""
    attack = spec.attack
    noise = attack.noise_replicates if spec.mode == "shape" else 0
    return attack.steps + 1, 2 + attack.random_replicates + noise


def _or_slowest(by_detector: dict[str, float], name: str) -> float:
    return by_detector.get(name, max(by_detector.values()))


def shipped_parts() -> TaskParts:
    """The figures that ship."""
    return TaskParts(**json.loads(SHIPPED.read_text(encoding="utf-8")))


def measured_parts(scores: pd.DataFrame, timings: pd.DataFrame, source: str) -> TaskParts:
    """From the tables of finished sweeps, one below the other; source: how to call them.

    Raises:
        InputError: they are of several accuracy presets.
    """
    import pandas as pd

    whose = scores.drop_duplicates("task_id")[["task_id", "mode", "detector", "accuracy"]]
    rows = timings.merge(whose, on="task_id")
    accuracies = sorted(whose["accuracy"].unique())
    if len(accuracies) != 1:
        raise InputError("sweeps", f"are of the accuracies {', '.join(accuracies)}: give sweeps of one")
    searches = rows["method"].eq("adversarial") & rows["stage"].isin([*_STEP, *_DESCENT])
    search, objects, rest = rows[searches], rows[~searches], rows[~rows["stage"].isin([*_STEP, *_DESCENT])]
    others = rest["stage"].str.startswith(_SCORED_BY)
    once = rest[~others & ~rest["stage"].isin(["total", "transfers", "effects_once"])]
    by_others = rest[others].assign(detector=rest[others]["stage"].str.removeprefix(_SCORED_BY))
    scored = pd.concat([objects[objects["stage"] == "detector"], by_others]).assign(stage="detector")
    return TaskParts(
        source=source,
        accuracy=accuracies[0],
        once_ms=_mean(once, "mode", whose.groupby("mode").size().to_dict()),
        step_ms=_mean(search[search["stage"].isin(_STEP)], "mode"),
        scored_ms=_mean(objects[objects["stage"].isin(_STEP)], "mode"),
        descent_ms=_mean(search[search["stage"].isin(_DESCENT)], "detector"),
        score_ms=_mean(scored, "detector"),
        placement_ms=round(float(rest.loc[rest["stage"] == "placement", "milliseconds"].mean()), 1),
    )


def _mean(rows: pd.DataFrame, by: str, calls: dict[str, int] | None = None) -> dict[str, float]:
    """Milliseconds a call of all stages together: each stage's mean, added up."""
    found = {}
    for name, some in rows.groupby(by):
        stages = some.groupby("stage")[["milliseconds", "calls"]].sum()
        number = calls[str(name)] if calls else stages["calls"]
        found[str(name)] = round(float((stages["milliseconds"] / number).sum()), 1)
    return found


def _main(folders: Sequence[str]) -> None:
    import pandas as pd

    sweeps = [read_sweep(folder) for folder in folders]
    scores = pd.concat([sweep.scored for sweep in sweeps])
    tasks = [f"{counted(sweep.scored['task_id'].nunique(), 'task')} of {sweep.plan.sweep}" for sweep in sweeps]
    parts = measured_parts(scores, pd.concat([sweep.timings for sweep in sweeps]), ", ".join(tasks))
    print(json.dumps(asdict(parts), indent=2))


if __name__ == "__main__":
    _main(sys.argv[1:])
