"""Simulated releases: rate at which a gate stops releases with and without a known loss of recall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from shift3d.analysis.statistics.loss import flip_p_values, scene_sums
from shift3d.seeding import generator

FloatArray = NDArray[np.float64]
MEASURES = ("recall", "mean score")  # Measures that a gate tests for each role's objects.
_SIMULATED_FLIPS = 1_999
_FLOOR = 0.005


@dataclass(frozen=True)
class ReleaseRule:
    """Rule that decides whether a release is worse. A measure stops the release if it fell by ``tolerance`` or more and
    its one-sided p-value, corrected for the number of measures, is at most ``level``. A score above ``score_threshold``
    is a detection. Source: our choice."""

    score_threshold: float = 0.3
    level: float = 0.05
    tolerance: float = 0.005

    def stops(self, changes: FloatArray, p_values: FloatArray) -> NDArray[np.bool_]:
        """Mask (..., J) of the measures that stop a release."""
        return np.asarray((p_values <= self.level) & (changes <= -self.tolerance))


@dataclass(frozen=True)
class SimulatedRates:
    """Rates of simulated releases. churn: standard deviation of the logit noise. lost: share of the hard objects that a
    release without a loss fails to detect (it gains as many). false_alarms: share stopped without a loss. found: share
    stopped with the loss; None if too few objects are detected for the loss."""

    churn: float
    lost: float
    false_alarms: float
    found: float | None


def measured_differences(
    before: FloatArray, after: FloatArray, groups: Sequence[NDArray[np.bool_]], score_threshold: float
) -> FloatArray:
    """Compute differences (N, ..., 2 G) of recall and score, group by group, 0 for objects of other groups.

    before, after: scores (N, ...). groups: G masks (N,). A score above the threshold is a detection.
    """
    changes = ((after > score_threshold).astype(float) - (before > score_threshold), after - before)
    shape = (-1,) + (1,) * (before.ndim - 1)
    return np.stack([np.where(group.reshape(shape), change, 0.0) for group in groups for change in changes], axis=-1)


def stopped_releases(
    scores: FloatArray,
    hard: NDArray[np.bool_],
    places: Sequence[str],
    churn: float,
    loss: float,
    rule: ReleaseRule,
    releases: int = 200,
) -> SimulatedRates:
    """Simulate releases around the scores (N,) of N objects in N named places, and count those that the gate stops.

    Both releases of a pair are the scores' logits with normal noise of standard deviation ``churn``; objects of a scene
    share half of the variance. Without a loss the two releases are exchangeable. For the loss, a number of objects
    equal to the share ``loss`` of all hard objects is drawn at random from the hard objects that both releases detect.
    Each of them gets a score between 0 and the threshold.

    Source: our choice.
    """
    score_threshold = rule.score_threshold
    rng = generator("simulated releases", len(scores), releases)
    _, scene = np.unique(np.asarray(places), return_inverse=True)
    logits = np.clip(scores, _FLOOR, 1.0 - _FLOOR)
    logits = np.log(logits / (1.0 - logits))[:, None, None]
    noise = [rng.standard_normal((size, releases, 2)) for size in (scene.max() + 1, len(scores))]
    pairs = 1.0 / (1.0 + np.exp(-(logits + churn * np.sqrt(0.5) * (noise[0][scene] + noise[1]))))
    if churn == 0.0:
        pairs = np.repeat(scores[:, None, None], releases, axis=1).repeat(2, axis=2)
    before, after = pairs[..., 0], pairs[..., 1]
    worse, feasible = after.copy(), True
    for release in range(releases):
        both = np.flatnonzero(hard & (before[:, release] > score_threshold) & (after[:, release] > score_threshold))
        number = ceil(loss * int(hard.sum()) - 1e-9)  # at least one object, else there is no loss
        feasible &= len(both) >= number
        taken = rng.permutation(both)[:number]
        worse[taken, release] = score_threshold * rng.random(len(taken))
    groups = [role for role in (hard, ~hard) if role.any()]
    rates = []
    sizes = np.repeat([role.sum() for role in groups], len(MEASURES))
    for new in (after, worse):
        differences = measured_differences(before, new, groups, score_threshold)
        p_values = flip_p_values(scene_sums(differences, places), _SIMULATED_FLIPS)
        rates.append(float(rule.stops(differences.sum(axis=0) / sizes, p_values).any(axis=-1).mean()))
    lost = ((before > score_threshold) & (after <= score_threshold))[hard].mean()
    return SimulatedRates(churn, float(lost), rates[0], rates[1] if feasible else None)
