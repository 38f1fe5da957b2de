"""Sign-flip test over whole scenes for a loss of score, and the number of objects that a loss of recall needs."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.analysis.statistics.rounding import without_rounding
from shift3d.seeding import generator

FloatArray = NDArray[np.float64]
_FLIPS = 9_999
_ALL_PATTERNS = 13  # Up to this number of scenes all sign patterns are enumerated, which makes the p-values exact.
_MOST_OBJECTS = 2**20


def scene_sums(differences: FloatArray, places: Sequence[str]) -> FloatArray:
    """Sum differences (N, ...) over places (N names), rounding set to 0. Returns (S, ...) without all-zero places."""
    _, index = np.unique(np.asarray(places), return_inverse=True)
    sums = np.zeros((index.max() + 1, *differences.shape[1:]))
    np.add.at(sums, index, differences)
    sums = without_rounding(sums)
    return np.asarray(sums[sums.reshape(len(sums), -1).any(axis=1)])


def flip_p_values(sums: FloatArray, flips: int = _FLIPS) -> FloatArray:
    """Compute one-sided p-values (..., J) of losses, corrected for testing J measures.

    sums: (S, ..., J) of differences after - before, over S scenes, of J measures; the axes between are independent
    tests. The statistic of a measure is -sum / sqrt(sum of squares) over the scenes. Under the null hypothesis before
    and after are exchangeable in each scene, for all measures together. Each statistic is therefore compared with the
    largest of the J under random sign flips of scenes. The level is exact for exchangeable releases, whatever the
    distribution and the dependence between measures or between objects of a scene. A measure without differences has
    p=1.

    Source: sign-flip (Fisher's randomization) test; single-step maxT of Westfall and Young 1993.
    """
    if not len(sums):
        return np.ones(sums.shape[1:])
    scale = np.sqrt((sums**2).sum(axis=0))
    whole = np.divide(-sums, scale, out=np.zeros_like(sums), where=scale > 0)
    found = whole.sum(axis=0)
    signs = _signs(len(sums), flips)
    flat = whole.reshape(len(sums), -1)
    drawn = (signs @ flat).reshape(len(signs), *found.shape).max(axis=-1, keepdims=True)
    at_least = (drawn >= found - 1e-9).mean(axis=0)
    return np.asarray(np.where(scale > 0, at_least, 1.0))


def least_p_value(scenes: int) -> float:
    """Return the smallest possible `flip_p_values` for the number of scenes."""
    return 1.0 / (2**scenes if scenes <= _ALL_PATTERNS else 1 + _FLIPS)


def _signs(scenes: int, flips: int) -> FloatArray:
    """Return sign patterns (B, S): all patterns for few scenes, else the identity and random patterns."""
    if scenes <= _ALL_PATTERNS:
        patterns = np.arange(2**scenes)[:, None] >> np.arange(scenes) & 1
        return np.asarray(1.0 - 2.0 * patterns, dtype=np.float64)
    drawn = generator("sign flips", scenes, flips).integers(0, 2, (flips, scenes))
    return np.concatenate((np.ones((1, scenes)), 1.0 - 2.0 * drawn))


def recall_power(objects: int, lost: float, gained: float, level: float) -> float:
    """Compute the probability that the exact sign test detects a loss of recall of independent objects.

    lost, gained: shares of the objects that only the old, or only the new, release detects. level: one-sided.
    Source: McNemar's test in its exact form, averaged over the number of discordant objects.
    """
    from scipy.stats import binom

    discordant = np.arange(objects + 1)
    weight = binom.pmf(discordant, objects, lost + gained)
    discordant, weight = discordant[weight > 1e-12], weight[weight > 1e-12]
    critical = binom.isf(level, discordant, 0.5) + 1  # the fewest losses that are significant
    return float((weight * binom.sf(critical - 1, discordant, lost / (lost + gained))).sum())


def objects_needed(loss: float, churn: float, power: float, level: float) -> int | None:
    """Find the smallest number of objects that detects a loss of recall with the given power.

    loss: share of the objects that is lost beyond churn. churn: share that is lost without a loss, and equally the
    share that is gained. Returns None if 2^20 objects, somewhat more than a million, are too few.
    """

    def enough(objects: int) -> bool:
        return recall_power(objects, churn + loss, churn, level) >= power

    high = 16
    while not enough(high):
        high *= 2
        if high > _MOST_OBJECTS:
            return None
    # The power of a discrete test is a sawtooth; the crossing that bisection finds is good enough.
    return bisect_left(range(high), True, lo=high // 2 + 1, key=enough)


def detectable_loss(objects: int, churn: float, power: float, level: float) -> float | None:
    """Find the smallest loss of recall, to 0.0005, that the objects show with the given power, or None."""
    steps = range(1, round((1.0 - 2.0 * churn) / 0.0005))
    found = bisect_left(steps, True, key=lambda n: recall_power(objects, churn + 0.0005 * n, churn, level) >= power)
    return 0.0005 * steps[found] if found < len(steps) else None
