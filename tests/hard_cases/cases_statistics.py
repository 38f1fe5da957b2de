"""Hard cases of a sweep's statistics: scores that are equal except for rounding."""

from __future__ import annotations

import numpy as np
import pandas as pd
from catalogue import hard_case

from shift3d.analysis.statistics.loss import flip_p_values, scene_sums
from shift3d.analysis.statistics.paired import paired

AREA = "statistics"


def tasks(*scores: dict[str, list[float]]) -> pd.DataFrame:
    """Make a task in its own scene for each item of scores by method; several scores of a method are its replicates."""
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


@hard_case(
    area=AREA,
    why="in each scene one object gains what two others lose, and 0.2 - 0.1 - 0.1 of such scores is not 0 but -6e-17",
    must="the scenes' sums are 0, and a gate finds no loss: p = 1",
    guard="sums of rounding are taken as none",
)
def gains_and_losses_that_cancel_in_every_scene() -> None:
    before, after = (np.tile(scores, 8) for scores in ((0.1, 0.3, 0.4), (0.3, 0.2, 0.3)))
    places = [f"scene {number // 3}" for number in range(24)]
    assert (after - before).reshape(8, 3).sum(axis=1).max() < 0.0
    sums = scene_sums((after - before)[:, None], places)
    assert (flip_p_values(sums) == 1.0).all()
    lost = scene_sums((after - before - 1e-9)[:, None], places)
    assert flip_p_values(lost) == 2.0**-8
