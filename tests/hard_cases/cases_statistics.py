"""Hard cases of a sweep's statistics: scores that are equal but for rounding."""

from __future__ import annotations

import pandas as pd
from catalogue import hard_case

from shift3d.analysis.statistics.paired import paired

AREA = "statistics"


def tasks(*scores: dict[str, list[float]]) -> pd.DataFrame:
    """A task in a scene of its own for each of the scores by method, several of one method its replicates."""
    return pd.DataFrame(
        {"task_id": f"task {number}", "place": f"scene {number}", "method": method, "score": score}
        for number, methods in enumerate(scores)
        for method, replicates in methods.items()
        for score in replicates
    )


@hard_case(
    area=AREA,
    why="three replicates of 0.1 have a mean of 0.09999999999999999: the same difference in every scene",
    must="methods with equal scores differ by 0, with p = 1, however many replicates they have; a real effect stays",
    guard="differences of rounding are taken as none",
)
def equal_scores_of_several_replicates() -> None:
    for score in (0.0, 0.1, 0.3, 0.7, 1.0):
        for replicates in (1, 3, 7, 10):
            equal = paired(
                tasks(*[{"adversarial": [score], "random": [score] * replicates}] * 8), "adversarial", "random"
            )
            assert equal is not None and equal.p_value == 1.0, (score, replicates)
            assert equal.interval.low == equal.interval.mean == equal.interval.high == 0.0
    real = paired(tasks(*[{"adversarial": [0.1 - 1e-9], "random": [0.1] * 3}] * 8), "adversarial", "random")
    assert real is not None and real.p_value == 2.0**-7 and real.interval.high < 0.0
