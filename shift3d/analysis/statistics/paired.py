"""Paired differences between methods, tested over scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from shift3d.analysis.statistics.intervals import Interval, mean_interval
from shift3d.analysis.statistics.rounding import DECIMALS, without_rounding


@dataclass(frozen=True)
class PairedDifference:
    """Difference between the scores of two methods on the same tasks. interval: mean difference, scenes resampled.
    p_value: Wilcoxon's signed-rank test, two-sided, over the scenes' mean differences; None with a single scene."""

    interval: Interval
    p_value: float | None
    scenes: int
    tasks: int


def paired(rows: pd.DataFrame, method: str, reference: str) -> PairedDifference | None:
    """Compare two methods task by task: method - reference, replicates averaged. Returns None if no task has both.

    rows: columns task_id, place, method, score. Differences at rounding level count as 0. Source: our choice: the paper
    states no test. The test counts scenes, not tasks, since vehicles in one scene are not independent draws.
    """
    table = rows.pivot_table(index=["place", "task_id"], columns="method", values="score", aggfunc="mean")
    if method not in table or reference not in table:
        return None
    difference = (table[method] - table[reference]).dropna()
    if difference.empty:
        return None
    difference[:] = without_rounding(difference.to_numpy())
    places = list(difference.index.get_level_values("place"))
    by_scene = without_rounding(difference.groupby(level="place").mean().to_numpy())
    return PairedDifference(mean_interval(difference, places), _signed_rank(by_scene), len(by_scene), len(difference))


def _signed_rank(differences: NDArray[np.float64]) -> float | None:
    from scipy.stats import wilcoxon

    if len(differences) < 2:
        return None
    # The ranks of equal differences must tie, but 0.9 - 0.7 exceeds 0.3 - 0.1 by rounding.
    ranked = np.round(differences, DECIMALS)
    return float(wilcoxon(ranked).pvalue) if ranked.any() else 1.0


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Correct p-values for their number by Holm's step-down; None stays None. Source: Holm 1979."""
    known = sorted((value, index) for index, value in enumerate(p_values) if value is not None)
    corrected: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        corrected[index] = largest
    return corrected
