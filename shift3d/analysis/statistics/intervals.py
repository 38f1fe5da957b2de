"""Confidence intervals by resampling scenes: objects of one scene are no independent draws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from shift3d.seeding import generator

FloatArray = NDArray[np.float64]
_CONFIDENCE = 0.95
_ENDS = ((1.0 - _CONFIDENCE) / 2.0, (1.0 + _CONFIDENCE) / 2.0)
_DRAWS, _BAND_DRAWS = 4000, 1000
# Of values that a BCa bootstrap holds at a time, 32 MB: its jackknife alone is groups by groups.
_HELD = 2**22


@dataclass(frozen=True)
class Interval:
    """A mean, and where it lies with 95 % confidence; infinite where there is nothing to resample."""

    mean: float
    low: float
    high: float


def mean_interval(values: ArrayLike, groups: Sequence[object], others: Sequence[object] | None = None) -> Interval:
    """Mean of values (N,) and its bootstrap interval, whole groups (N names) drawn with replacement.

    With a single group the interval is infinite. Where all groups agree it is a point. The same values give the same
    interval.

    With few groups it is too narrow, as bootstraps are: of normal draws it held the mean in 88 % of the cases with 8
    groups, 93 % with 20, 94 % with 40, 95 % with 200 (1,000 repetitions each).

    others: N names of groups that are draws too, see `_crossed`.

    Source: Efron's BCa bootstrap (scipy), clusters resampled (Davison and Hinkley 1997, section 3.8).
    """
    numbers = np.asarray(values, dtype=np.float64)
    names, index = np.unique(np.asarray([str(group) for group in groups]), return_inverse=True)
    mean = float(numbers.mean())
    if others is not None:
        influences = (numbers - mean) / len(numbers)
        return _crossed(mean_interval(values, groups), influences, groups, others)
    if len(names) < 2:
        return Interval(mean, -np.inf, np.inf)
    sums, counts = (np.bincount(index, part).astype(np.float64) for part in (numbers, np.ones_like(numbers)))
    if np.ptp(sums / counts) <= 1e-12 * max(1.0, abs(mean)):
        return Interval(mean, mean, mean)
    return _bca((sums, counts), lambda s, c, axis: s.sum(axis=axis) / c.sum(axis=axis), mean, len(numbers))


def _bca(parts: Sequence[FloatArray], statistic: Callable[..., FloatArray], mean: float, number: int) -> Interval:
    """A statistic's BCa interval, the same to the bit in batches of any size.

    parts: arrays (G,), a value a group. number: of values, for the random draws.
    """
    from scipy.stats import bootstrap

    found = bootstrap(
        tuple(parts),
        statistic,
        paired=True,
        vectorized=True,
        n_resamples=_DRAWS,
        batch=max(_HELD // (len(parts) * len(parts[0])), 1),
        confidence_level=_CONFIDENCE,
        method="BCa",
        rng=generator("bootstrap", number, len(parts[0])),
    ).confidence_interval
    return Interval(mean, float(found.low), float(found.high))


def difference_interval(
    values: ArrayLike, inside: NDArray[np.bool_], groups: Sequence[object], others: Sequence[object] | None = None
) -> Interval:
    """Mean of the values (N,) inside less that of the others, and its percentile bootstrap, whole groups redrawn.

    inside: (N,), neither all nor none. Infinite where fewer than two groups hold values on either side. others: N names
    of groups that are draws too, see `_beside_others`.
    Source: Davison and Hinkley 1997, section 3.8 (clusters).
    """
    numbers = np.asarray(values, dtype=np.float64)
    if others is not None:
        return _beside_others(difference_interval(values, inside, groups), numbers, inside, others)
    _, index = np.unique(np.asarray([str(group) for group in groups]), return_inverse=True)
    sides = []
    for rows in (inside, ~inside):
        count = np.bincount(index[rows], minlength=index.max() + 1).astype(np.float64)
        sides.append((np.bincount(index[rows], numbers[rows], minlength=len(count)), count))
    mean = float(numbers[inside].mean() - numbers[~inside].mean())
    if any(int((count > 0).sum()) < 2 for _, count in sides):
        return Interval(mean, -np.inf, np.inf)
    drawn = _redrawn(len(sides[0][1]), _DRAWS, "difference of means", len(numbers))
    with np.errstate(divide="ignore", invalid="ignore"):
        inner, outer = ((drawn @ sums) / (drawn @ count) for sums, count in sides)
    found = inner - outer
    low, high = np.quantile(found[np.isfinite(found)], _ENDS)
    return Interval(mean, min(float(low), mean), max(float(high), mean))


def _beside_others(
    found: Interval, numbers: FloatArray, inside: NDArray[np.bool_], others: Sequence[object]
) -> Interval:
    """A difference's interval that redraws groups, widened by what other groups, as vehicles, differ among each other.

    A mean over few of them says little of others, however many values each has. They differ as much on one side as on
    the other: the few of one side say too little of that themselves. Infinite where fewer than two are on either side.

    numbers, inside, others: (N,) as of `difference_interval`.
    Source: Student's two-sample t over the groups' means, its square added to that of the interval.
    """
    names, index = np.unique(np.asarray([str(one) for one in others]), return_inverse=True)
    sides = inside, ~inside
    on = [len(np.unique(index[side])) for side in sides]
    freedom = len(names) - (1 if min(on) == len(names) else 2)  # one mean, or one a side
    if min(on) < 2:
        return Interval(found.mean, -np.inf, np.inf)
    means = np.where(inside, *(numbers[side].mean() for side in sides))
    apart = np.bincount(index, numbers - means) / np.bincount(index)
    shares = np.bincount(index, np.where(inside, 1.0 / inside.sum(), -1.0 / (~inside).sum()))
    return _widened(found, (apart**2).sum() / freedom * (shares**2).sum(), freedom)


def _widened(found: Interval, variance: float, freedom: int) -> Interval:
    """An interval with a further variance of so many degrees of freedom."""
    from scipy.stats import t

    half = t.ppf(_ENDS[1], freedom) * np.sqrt(variance)
    below, above = (float(np.hypot(end - found.mean, half)) for end in (found.low, found.high))
    return Interval(found.mean, found.mean - below, found.mean + above)


def _crossed(found: Interval, influences: FloatArray, groups: Sequence[object], others: Sequence[object]) -> Interval:
    """A mean's interval that redraws groups, widened by what other groups of the same rows add to the variance.

    Objects of one scene are no independent draws, and neither are those of one shape: the variance is that over the
    groups, plus that over the others, less that over both together, which is in either. Infinite where the others are a
    single one.

    influences: (N,) by how much each row moves the mean. groups, others: N names each.
    Source: Cameron, Gelbach and Miller 2011 (two-way clusters), with Student's t for few of the others.
    """
    count = len(set(map(str, others)))
    if count < 2:
        return Interval(found.mean, -np.inf, np.inf)
    added = _variance(influences, others) * count / (count - 1) - _variance(influences, list(zip(groups, others)))
    return _widened(found, max(added, 0.0), count - 1)


def _variance(influences: FloatArray, groups: Sequence[object]) -> float:
    """Of a mean, over groups (N names) of rows that move it so far (N,)."""
    _, index = np.unique(np.asarray([str(group) for group in groups]), return_inverse=True)
    return float((np.bincount(index, influences) ** 2).sum())


def vehicle_mean_interval(rows: pd.DataFrame) -> Interval:
    """Mean over vehicles of their mean scores, and its BCa bootstrap, scenes with all their vehicles drawn together.

    rows: columns score, vehicle, place. A vehicle without a scene in a draw is left out of that draw's mean. Infinite
    with a single place, a point where all places agree. Where the mean stays what it is whichever place is left out, as
    where each vehicle has one score everywhere, BCa's acceleration is 0 / 0: the percentiles of the draws stand then.
    Source: as `mean_interval`.
    """
    places, vehicles = (sorted(set(rows[name])) for name in ("place", "vehicle"))
    sums, counts = _sums(rows, places, vehicles)
    count = len(vehicles)

    def statistic(*parts: FloatArray, axis: int) -> FloatArray:
        drawn, numbers = (np.stack([part.sum(axis=axis) for part in half]) for half in (parts[:count], parts[count:]))
        return _mean_of_means(drawn, numbers, axis=0)

    mean = float(statistic(*sums.T, *counts.T, axis=0))
    if len(places) < 2:
        return Interval(mean, -np.inf, np.inf)
    if np.ptp(_mean_of_means(sums, counts, axis=1)) <= 1e-12 * max(1.0, abs(mean)):
        return Interval(mean, mean, mean)
    without_one = _mean_of_means(sums.sum(axis=0) - sums, counts.sum(axis=0) - counts, axis=1)
    if np.ptp(without_one) <= 1e-12 * max(1.0, abs(mean)):
        drawn = _vehicle_mean(_redrawn(len(places), _DRAWS, "flat jackknife", len(rows)), sums, counts)
        low, high = np.quantile(drawn, _ENDS)
        return Interval(mean, min(float(low), mean), max(float(high), mean))
    return _bca((*sums.T, *counts.T), statistic, mean, len(rows))


def ratio_interval(rows: pd.DataFrame, reference: pd.DataFrame, others: str | None = None) -> Interval | None:
    """Mean over vehicles of the AUCs of some rows over that of others, and its percentile bootstrap.

    rows, reference: columns score, vehicle, place. Places are redrawn whole, with both their parts, so that what makes
    a scene hard is in both. None where a part is empty or the reference is 0; infinite with a single place. Its end is
    infinite where more than 2.5 % of the draws hold none of the reference but scores of 0. others: column of groups
    that are draws too, see `_crossed`.
    Source: Davison and Hinkley 1997, section 3.8 (clusters).
    """
    if rows.empty or reference.empty:
        return None
    if others is not None:
        return _crossed_ratio(rows, reference, others)
    places, vehicles = (sorted({*rows[name], *reference[name]}) for name in ("place", "vehicle"))
    above, below = (_sums(part, places, vehicles) for part in (rows, reference))
    one = np.ones((1, len(places)))
    whole = _vehicle_mean(one, *below)[0]
    if not whole > 0:
        return None
    ratio = float(_vehicle_mean(one, *above)[0] / whole)
    if len(places) < 2:
        return Interval(ratio, -np.inf, np.inf)
    drawn = _redrawn(len(places), _DRAWS, "ratio of areas", len(rows), len(reference))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = _vehicle_mean(drawn, *above) / _vehicle_mean(drawn, *below)
    ordered = np.sort(found[~np.isnan(found)])  # a draw without any row of one part has no ratio, nor has 0 / 0
    low, high = (_quantile(ordered, end) for end in _ENDS)
    return Interval(ratio, min(low, ratio), max(high, ratio))


def _crossed_ratio(rows: pd.DataFrame, reference: pd.DataFrame, others: str) -> Interval | None:
    """`ratio_interval` where the groups of a column are draws, too."""
    if (found := ratio_interval(rows, reference)) is None:
        return None
    parts = []
    for part in (rows, reference):
        by_vehicle = part.groupby("vehicle")["score"]
        means, counts = by_vehicle.transform("mean"), by_vehicle.transform("size")
        parts.append((part["score"] - means) / counts / by_vehicle.ngroups)
    below = reference.groupby("vehicle")["score"].mean().mean()
    influences = np.concatenate((parts[0], -found.mean * parts[1])) / below
    both = pd.concat([rows, reference])
    return _crossed(found, influences, both["place"], both[others])


def _quantile(ordered: FloatArray, share: float) -> float:
    """A quantile of ascending values (N,), the last of which may be infinite: between these nothing is interpolated."""
    above = ordered[int(np.ceil(share * (len(ordered) - 1)))]
    return float(np.quantile(ordered, share)) if np.isfinite(above) else float(above)


def _redrawn(places: int, draws: int, *seed: str | int) -> FloatArray:
    """How often each place is drawn (D, P), with replacement."""
    rng = generator(*seed, places)
    return rng.multinomial(places, np.full(places, 1.0 / places), size=draws).astype(np.float64)


def _sums(rows: pd.DataFrame, places: list[str], vehicles: list[str]) -> tuple[FloatArray, FloatArray]:
    """Sums and numbers of scores (P, V) by place and vehicle."""
    at = np.searchsorted(places, rows["place"]), np.searchsorted(vehicles, rows["vehicle"])
    sums, counts = (np.zeros((len(places), len(vehicles))) for _ in range(2))
    np.add.at(sums, at, rows["score"].to_numpy(dtype=np.float64))
    np.add.at(counts, at, 1.0)
    return sums, counts


def _vehicle_mean(drawn: FloatArray, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Mean over vehicles of their mean scores (D,) when each place counts as often as drawn (D, P) tells."""
    return _mean_of_means(drawn @ sums, drawn @ counts, axis=1)


def _mean_of_means(sums: FloatArray, counts: FloatArray, axis: int) -> FloatArray:
    """Along an axis, the mean of sums over counts where there is a count; NaN where there is none."""
    means = np.divide(sums, counts, out=np.zeros_like(sums), where=counts > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(means.sum(axis=axis) / (counts > 0).sum(axis=axis))


def recall_band(
    scores: ArrayLike, places: Sequence[str], thresholds: FloatArray
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """recall(t) = P(score > t) at thresholds (T,), and its `resampled_band`. scores: (N,) in [0, 1], of N places."""
    values = np.asarray(scores, dtype=np.float64)
    return resampled_band((values[:, None] > thresholds).astype(np.float64), places, "recall band")


def resampled_band(
    values: FloatArray, places: Sequence[str], name: str
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Mean over the rows of values (N, T), and its pointwise percentile bootstrap, whole places (N names) redrawn.

    name: of the random draws: the same values give the same band. Returns mean, low and high (T,); low and high are
    None where there is but one place. Source: Davison and Hinkley 1997, section 3.8 (clusters).
    """
    _, index = np.unique(np.asarray(places), return_inverse=True)
    counts = np.bincount(index).astype(np.float64)
    sums = np.zeros((len(counts), values.shape[1]))
    np.add.at(sums, index, values)
    mean = sums.sum(axis=0) / counts.sum()
    if len(counts) < 2:
        return mean, None, None
    drawn = _redrawn(len(counts), _BAND_DRAWS, name, len(values))
    low, high = np.quantile((drawn @ sums) / (drawn @ counts)[:, None], _ENDS, axis=0)
    # A skewed bootstrap may leave out its own estimate; a band that does not hold its curve would mislead.
    return mean, np.minimum(low, mean), np.maximum(high, mean)
