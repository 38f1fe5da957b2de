"""Areas under curves, paired differences and bands: scenes are what is resampled, and what a test counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from shift3d.analysis.statistics.intervals import CONFIDENCE, Interval, mean_interval
from shift3d.seeding import generator

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Area",
    "Band",
    "Paired",
    "area",
    "holm",
    "mean_area",
    "paired",
    "ratio_interval",
    "recall_band",
    "resampled_band",
]

FloatArray = npt.NDArray[np.float64]
_DRAWS = 1000
_RATIO_DRAWS = 4000


@dataclass(frozen=True)
class Area:
    """An AUC with its interval, and what lies behind it. interval is infinite where there is but one scene."""

    interval: Interval
    scenes: int
    scores: int


def area(rows: pd.DataFrame) -> Area | None:
    """AUC of rows with columns score and place; None without rows. The AUC is the mean score exactly."""
    if rows.empty:
        return None
    return Area(mean_interval(rows["score"], list(rows["place"])), rows["place"].nunique(), len(rows))


def mean_area(rows: pd.DataFrame) -> Area | None:
    """Mean over vehicles of their AUCs, its interval from scenes with all their vehicles drawn together.

    rows: columns score, vehicle, place. Scores are weighted so that their mean is the mean of the vehicles' AUCs,
    whatever number of scores each has.
    """
    if rows.empty:
        return None
    share = rows.groupby("vehicle")["score"].transform("size")
    weighted = rows["score"] * (len(rows) / (rows["vehicle"].nunique() * share))
    return Area(mean_interval(weighted, list(rows["place"])), rows["place"].nunique(), len(rows))


def ratio_interval(rows: pd.DataFrame, reference: pd.DataFrame) -> Interval | None:
    """Mean over vehicles of the AUCs of some rows over that of others, and its bootstrap interval.

    rows, reference: columns score, vehicle, place. Places are redrawn whole, with both their parts, so that what makes
    a scene hard is in both; percentiles of 4,000 draws. None where a part is empty or the reference is 0. With a
    single place the interval is infinite. Source: Davison and Hinkley 1997, section 3.8 (clusters).
    """
    if rows.empty or reference.empty:
        return None
    places, vehicles = (sorted({*rows[name], *reference[name]}) for name in ("place", "vehicle"))
    above, below = (_sums(part, places, vehicles) for part in (rows, reference))
    one = np.ones((1, len(places)))
    whole = _vehicle_mean(one, *below)[0]
    if not whole > 0:
        return None
    ratio = float(_vehicle_mean(one, *above)[0] / whole)
    if len(places) < 2:
        return Interval(ratio, -np.inf, np.inf)
    rng = generator("ratio of areas", len(rows), len(reference), len(places))
    drawn = rng.multinomial(len(places), np.full(len(places), 1.0 / len(places)), size=_RATIO_DRAWS).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = _vehicle_mean(drawn, *above) / _vehicle_mean(drawn, *below)
    known = found[np.isfinite(found)]  # a draw without any row of one part has no ratio
    low, high = np.quantile(known, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    return Interval(ratio, min(float(low), ratio), max(float(high), ratio))


def _sums(rows: pd.DataFrame, places: list[str], vehicles: list[str]) -> tuple[FloatArray, FloatArray]:
    """Sums and numbers of scores (P, V) by place and vehicle."""
    at = np.searchsorted(places, rows["place"]), np.searchsorted(vehicles, rows["vehicle"])
    sums, counts = (np.zeros((len(places), len(vehicles))) for _ in range(2))
    np.add.at(sums, at, rows["score"].to_numpy(dtype=np.float64))
    np.add.at(counts, at, 1.0)
    return sums, counts


def _vehicle_mean(drawn: FloatArray, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Mean over vehicles of their mean scores (D,) when each place counts as often as drawn (D, P) says."""
    numbers = drawn @ counts
    means = np.divide(drawn @ sums, numbers, out=np.zeros_like(numbers), where=numbers > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(means.sum(axis=1) / (numbers > 0).sum(axis=1))


@dataclass(frozen=True)
class Paired:
    """How far a method's scores differ from another's of the same tasks.

    interval: mean difference, scenes resampled. p_value: Wilcoxon's signed-rank test, two-sided, over the scenes' mean
    differences; None with a single scene.
    """

    interval: Interval
    p_value: float | None
    scenes: int
    tasks: int


def paired(rows: pd.DataFrame, method: str, reference: str) -> Paired | None:
    """Differences method - reference, task by task (replicates averaged); None where no task has both.

    rows: columns task_id, place, method, score. Source: our choice: the paper states no test. Scenes, not tasks, are
    counted by the test, since vehicles in one scene are no independent draws.
    """
    table = rows.pivot_table(index=["place", "task_id"], columns="method", values="score", aggfunc="mean")
    if method not in table or reference not in table:
        return None
    difference = (table[method] - table[reference]).dropna()
    if difference.empty:
        return None
    places = list(difference.index.get_level_values("place"))
    by_scene = difference.groupby(level="place").mean().to_numpy()
    return Paired(mean_interval(difference, places), _signed_rank(by_scene), len(by_scene), len(difference))


def _signed_rank(differences: FloatArray) -> float | None:
    from scipy.stats import wilcoxon

    if len(differences) < 2:
        return None
    if not differences.any():
        return 1.0
    return float(wilcoxon(differences).pvalue)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """p-values corrected for their number by Holm's step-down; None stays None. Source: Holm 1979."""
    known = sorted((value, index) for index, value in enumerate(p_values) if value is not None)
    corrected: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        corrected[index] = largest
    return corrected


@dataclass(frozen=True)
class Band:
    """Recall at thresholds (T,), and where it lies pointwise with 95 % confidence; low, high are None for one scene."""

    score_threshold: FloatArray
    recall: FloatArray
    low: FloatArray | None
    high: FloatArray | None


def recall_band(scores: npt.ArrayLike, places: Sequence[str], thresholds: FloatArray) -> Band:
    """recall(t) = P(score > t) at thresholds (T,), and its pointwise percentile bootstrap, whole scenes redrawn.

    Args:
        scores: (N,) in [0, 1]. places: N names of scenes. thresholds: ascending.

    Source: Davison and Hinkley 1997, section 3.8 (clusters). The same values give the same band.
    """
    values = np.asarray(scores, dtype=np.float64)
    return Band(thresholds, *resampled_band((values[:, None] > thresholds).astype(np.float64), places, "recall band"))


def resampled_band(
    values: FloatArray, places: Sequence[str], name: str
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Mean over the rows of values (N, T), and its pointwise percentile bootstrap, whole places (N names) redrawn.

    name: of the random draws. Returns mean, low and high (T,); low and high are None where there is but one place.
    """
    _, index = np.unique(np.asarray(places), return_inverse=True)
    counts = np.bincount(index).astype(np.float64)
    sums = np.zeros((len(counts), values.shape[1]))
    np.add.at(sums, index, values)
    mean = sums.sum(axis=0) / counts.sum()
    if len(counts) < 2:
        return mean, None, None
    rng = generator(name, len(values), len(counts))
    drawn = rng.multinomial(len(counts), np.full(len(counts), 1.0 / len(counts)), size=_DRAWS).astype(np.float64)
    found = (drawn @ sums) / (drawn @ counts)[:, None]
    low, high = np.quantile(found, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0], axis=0)
    # A skewed bootstrap may leave out its own estimate; a band that does not hold its curve would mislead.
    return mean, np.minimum(low, mean), np.maximum(high, mean)
