"""Selection of the solutions that a page shows: the hardest, and a random sample."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import pandas as pd

from shift3d.seeding import generator

_LEAST_FALL = 0.01  # Least fall of the score for a hard case (our choice).


@dataclass(frozen=True)
class Case:
    """Task with the attacked detector's scores. before: of the baseline. after: of the adversarial object."""

    task_id: str
    vehicle: str
    scene: str
    mode: str
    before: float
    after: float

    @property
    def fall(self) -> float:
        """Decrease of the score."""
        return self.before - self.after


def falls(scores: pd.DataFrame) -> list[Case]:
    """Return a case for every task with both scores, in the plan's order. scores: the table of ``final/``."""
    rows = scores[(scores["scored_by"] == scores["detector"]) & scores["score"].notna() & (scores["replicate"] == 0)]
    table = rows.pivot_table(index="task_id", columns="method", values="score")
    if not {"baseline", "adversarial"} <= set(table.columns):
        return []
    both = table[["baseline", "adversarial"]].dropna().to_dict("index")
    return [
        Case(row.task_id, row.vehicle, row.scene, row.mode, *map(float, both[row.task_id].values()))
        for row in rows.drop_duplicates("task_id").itertuples()
        if row.task_id in both
    ]


def hardest(scores: pd.DataFrame, count: int = 4, unnatural: Collection[str] = ()) -> list[Case]:
    """Select the tasks whose score fell furthest, by 0.01 or more, preferring new vehicles and scenes.

    Of equal falls the first in the plan's order is taken. unnatural: tasks that are taken only if there are fewer than
    `count` others, and are listed last.
    """
    left = sorted((case for case in falls(scores) if case.fall >= _LEAST_FALL), key=lambda case: -case.fall)
    chosen: list[Case] = []
    while left and len(chosen) < count:
        # min() returns the first of the least repetitive cases, which is the one that fell furthest.
        best = min(left, key=lambda case: (case.task_id in unnatural, _repeats(case, chosen)))
        chosen.append(best)
        left.remove(best)
    return sorted(chosen, key=lambda case: (case.task_id in unnatural, -case.fall))


def _repeats(case: Case, chosen: list[Case]) -> int:
    vehicles = sum(case.vehicle == other.vehicle for other in chosen)
    return vehicles + sum(case.scene == other.scene for other in chosen)


def random_positions(tasks: int, count: int, seed: str) -> list[int]:
    """Draw ascending positions of tasks uniformly by seed, whatever their outcome; all if not more than `count`."""
    drawn = generator("gallery", seed).choice(tasks, size=min(count, tasks), replace=False)
    return sorted(int(position) for position in drawn)
