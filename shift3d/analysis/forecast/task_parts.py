"""What the parts of a task take, as measured on finished sweeps by ``docs/scripts/shipped.py``.

Source: our choice.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from shift3d.task.spec import TaskSpec

__all__ = ["SHIPPED", "TaskParts", "searched", "shipped_parts"]

SHIPPED = Path(__file__).resolve().parent.parent / "measured" / "task_parts.json"
"""Written by ``docs/scripts/shipped.py``."""


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
        """Milliseconds of one task at this accuracy, without effects.

        Modes and detectors that were not measured count as the slowest.
        """
        steps, objects = searched(spec)
        each_step = _or_slowest(self.step_ms, spec.mode) + _or_slowest(self.descent_ms, spec.detector)
        scored_ms = _or_slowest(self.scored_ms, spec.mode)
        each_object = scored_ms + sum(_or_slowest(self.score_ms, name) for name in spec.scored_by)
        # In another scene a place is found, and the shape and its baseline are scored there.
        judging = max(len(spec.transfer_scenes) - spec.attack.search_scenes, 0)
        others = len(spec.transfer_scenes) * self.placement_ms + judging * 2 * each_object
        return _or_slowest(self.once_ms, spec.mode) + steps * each_step + objects * each_object + others


def searched(spec: TaskSpec) -> tuple[int, int]:
    """Renderings of a task's search, and of the objects that it scores."""
    attack = spec.attack
    noise = attack.noise_replicates if spec.mode != "pose" else 0
    beside = int(bool(attack.edit) and spec.mode != "pose") + attack.random_search
    searches = 1 + attack.random_search
    places = 1 + min(attack.search_scenes, len(spec.transfer_scenes))
    return searches * places * (attack.steps + 1), 2 + attack.random_replicates + beside + noise


def _or_slowest(measured: dict[str, float], name: str) -> float:
    return measured.get(name, max(measured.values()))


def shipped_parts() -> TaskParts:
    """The figures that ship."""
    return TaskParts(**json.loads(SHIPPED.read_text(encoding="utf-8")))
