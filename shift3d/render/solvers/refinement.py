"""Adaptive interval refinement: the one rule that decides whether a ray can hide a crossing.

Let no field be steeper than a slope L. Between two samples g_a and g_b at a distance w nothing can hide if
g_a + g_b >= L w (Piyavskii 1972): the free spheres around the samples cover the interval. An interval that this leaves
open is sampled where its lower bound is least, at k = middle + (g_a - g_b) / 2 L. The open intervals of all rays are
sampled in one call, until every ray is proven free or enters the object. The rule is the same for measured and for
predicted samples (from a grid or an earlier rendering): a predicted sample counts less its error bound, and is measured
if that is not enough.

L is `1 / step_safety`, times the steepest slope measured on the ray if that exceeds 1. A length of `step_m` may stay
uncovered. Next to local minima and where g hardly falls that allowance does not hold; there L is taken from the nearest
samples (`local_minima`). An interval that g crosses at a flat angle may hold several crossings, and is halved down to
`grazing_m`.

Source: our choice: sphere tracing (Hart 1996) takes one step of every ray at a time, from its start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.field.object_field import ObjectField
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.ray_samples import RaySamples, by_ray_and_range

_ROUNDS = 40
_STEEPEST = 10.0
# Predicted samples below `_LOW_M` are measured. So are those below `_WATCHED_M` that are a local minimum, or the lowest
# of their ray up to `_WATCHED_STEPS` steps before its hit.
_LOW_M = 0.003
_WATCHED_M = 0.05
_WATCHED_STEPS = 3
# On a clear approach the mean fall of g up to the hit is at least this share of the fall just before.
_SLACKENS = 0.7
# Next to a local minimum g may fall `_STEEPER` times as fast as measured, and at least at the slope `_FLATTEST`.
_STEEPER = 2.0
_FLATTEST = 0.1
_NARROW_M = 2e-4
_BEHIND_M = 1e-6
_SAMPLE, _NEAR, _FAR, _HIT, _INSIDE = range(5)


@dataclass(frozen=True)
class Brackets:
    """Brackets of B crossings, by ray: g_outer (B,) >= 0 at range outer, g_inner (B,) < 0 at range inner, metres."""

    rows: Tensor
    outer: Tensor
    inner: Tensor
    g_outer: Tensor
    g_inner: Tensor


@dataclass(frozen=True)
class Refinement:
    """Results of refining M rays.

    samples: of all rays, none behind a crossing. brackets: crossings that were found. undecided: (M,) bool, the field
    is not finite. open: (M,) bool, rays that begin inside the object, or that the refinement could not close.
    """

    samples: RaySamples
    brackets: Brackets
    undecided: Tensor
    open: Tensor


def refine(samples: RaySamples, rays: Rays, hit_m: Tensor, field: ObjectField, settings: RenderSettings) -> Refinement:
    """Refine intervals until every ray is proven free up to its hit, or up to its end.

    Args:
        samples: measured and predicted samples; a ray may have none.
        hit_m: (M,) float64 range of a known hit, NaN if none is known.
    Not differentiable.
    """
    end_m = torch.where(torch.isnan(hit_m), torch.inf, hit_m)
    samples = samples.before(end_m)
    if settings.local_minima:
        samples = _mark_low_samples(samples, end_m - _WATCHED_STEPS * settings.step_m)
    samples = _thinned(samples, end_m, settings)
    nodes, done = _Nodes.of(samples, rays, hit_m).up_to_first_inside(len(rays)), []
    undecided = torch.zeros(len(rays), dtype=torch.bool)
    for _ in range(_ROUNDS):
        measured, places = nodes.wanted(len(rays), settings)
        busy = torch.zeros_like(undecided)
        busy[nodes.rows[measured]] = True
        busy[places.rows] = True
        on = busy[nodes.rows]
        done.append(nodes.select(~on))
        measured, nodes = measured[on], nodes.select(on)
        if len(nodes.rows) == 0:
            break
        at = torch.nonzero(measured).squeeze(1)
        rows, k = torch.cat((nodes.rows[at], places.rows)), torch.cat((nodes.k[at], places.k))
        g = field.estimate(rays.at(k, rows), torch.cat((nodes.g[at], places.g))).double()
        undecided[rows[~torch.isfinite(g)]] = True
        nodes = nodes.with_measured(at, g[: len(at)], len(rays)).with_nodes(replace(places, g=g[len(at) :]))
        nodes = nodes.select(~undecided[nodes.rows]).up_to_first_inside(len(rays))
    unrefined = torch.zeros_like(undecided)
    unrefined[nodes.rows] = True
    nodes = _Nodes.stacked(done)
    brackets, starts_inside = _entries(nodes, len(rays))
    kept = nodes.select(nodes.kind == _SAMPLE)
    left = RaySamples.none().joined(RaySamples(kept.rows, kept.k, kept.g, kept.error))
    return Refinement(left, brackets, undecided, unrefined | starts_inside)


def _is_clear_approach(
    width_m: Tensor, g: Tensor, lower: Tensor, fall_before: Tensor, settings: RenderSettings
) -> Tensor:
    """Return a mask of places from which the approach to the hit is clear, so that nothing can hide in between.

    On a clear approach g falls at no flat angle and about as fast as in front of the place; where g falls slower, the
    beam may cross a fold before the hit. width_m: distance to the hit. lower: g less its error bound. fall_before: fall
    of g per metre on the interval in front of the place.
    """
    steep = lower >= settings.approach_slope * width_m
    return (width_m <= settings.approach_m) & steep & (g >= _SLACKENS * fall_before * width_m)


def _fall_before(rows: Tensor, k: Tensor, g: Tensor) -> Tensor:
    """Compute (S,) the fall of g per metre on the interval in front of each sample; 0 for a ray's first sample."""
    fall = (g[:-1] - g[1:]) / (k[1:] - k[:-1]).clamp_min(1e-12)
    return torch.cat((g.new_zeros(min(1, len(g))), torch.where(rows[1:] == rows[:-1], fall, 0.0)))


def _thinned(samples: RaySamples, end_m: Tensor, settings: RenderSettings) -> RaySamples:
    """Drop predicted samples behind the start of a clear approach to the hit (M,), and those that prove nothing.

    A sample proves nothing if only its error bound takes it below `_LOW_M`, unless `_mark_low_samples` marked it.
    """
    rises = (samples.g[1:] > samples.g[:-1]) & (samples.rows[1:] == samples.rows[:-1])
    rows, k = samples.rows[1:][rises], samples.k[1:][rises]
    falls_from = torch.full_like(end_m, -torch.inf).scatter_reduce(0, rows, k, "amax")
    before = _fall_before(samples.rows, samples.k, samples.g)
    plain = _is_clear_approach(end_m[samples.rows] - samples.k, samples.g, samples.g - samples.error, before, settings)
    plain &= samples.k >= falls_from[samples.rows]
    first = torch.full_like(end_m, torch.inf).scatter_reduce(0, samples.rows[plain], samples.k[plain], "amin")
    useful = (samples.g - samples.error > _LOW_M) | (samples.g <= _LOW_M) | (samples.error == samples.g)
    return samples.select(((samples.k <= first[samples.rows]) & useful) | (samples.error == 0))


def _mark_low_samples(samples: RaySamples, until_m: Tensor) -> RaySamples:
    """Mark, to be measured, predicted samples that are low local minima or each ray's lowest up to a range (M,).

    Small features change between the nodes of a coarse grid, and appear where little room is left.
    """
    same = samples.rows[1:] == samples.rows[:-1]
    inf = samples.g.new_full((1,), torch.inf)
    before = torch.cat((inf, torch.where(same, samples.g[:-1], torch.inf)))[: len(samples)]
    after = torch.cat((torch.where(same, samples.g[1:], -torch.inf), -inf))[: len(samples)]
    early = samples.k < until_m[samples.rows]
    least = torch.full_like(until_m, torch.inf)
    least = least.scatter_reduce(0, samples.rows[early], samples.g[early], "amin")[samples.rows]
    low = (samples.g <= before) & (samples.g <= after) | early & (samples.g == least)
    low &= (samples.g < _WATCHED_M) & (samples.error > 0)
    return replace(samples, error=torch.where(low, torch.maximum(samples.error, samples.g), samples.error))


def _entries(nodes: _Nodes, count: int) -> tuple[Brackets, Tensor]:
    """Return the brackets of rays that end inside, and a mask (M,) of those without a sample outside in front."""
    at = torch.nonzero(nodes.kind == _INSIDE).squeeze(1)
    before = (at - 1).clamp_min(0)
    from_outside = (at > 0) & (nodes.rows[before] == nodes.rows[at]) & (nodes.kind[before] == _SAMPLE)
    starts_inside = torch.zeros(count, dtype=torch.bool)
    starts_inside[nodes.rows[at[~from_outside]]] = True
    at, before = at[from_outside], before[from_outside]
    return Brackets(nodes.rows[at], nodes.k[before], nodes.k[at], nodes.g[before], nodes.g[at]), starts_inside


@dataclass(frozen=True)
class _Nodes(RaySamples):
    """Samples and end points of rays, ordered by ray and range; kind: (K,) type of each node."""

    kind: Tensor

    @staticmethod
    def of(samples: RaySamples, rays: Rays, hit_m: Tensor) -> _Nodes:
        """Build nodes from the samples and from the starts and ends of the rays."""
        every, is_hit = torch.arange(len(rays)), torch.isfinite(hit_m)
        end_m, kind = torch.where(is_hit, hit_m, rays.far_m), torch.where(is_hit, _HIT, _FAR)
        inner = _Nodes(**vars(samples), kind=torch.full_like(samples.rows, _SAMPLE))
        near = _Nodes.empty(every, rays.near_m, torch.full_like(every, _NEAR))
        return near.with_nodes(inner).with_nodes(_Nodes.empty(every, end_m, kind))

    @staticmethod
    def empty(rows: Tensor, k: Tensor, kind: Tensor) -> _Nodes:
        """Return nodes without a value: g and error are 0."""
        return _Nodes(rows, k, torch.zeros_like(k), torch.zeros_like(k), kind)

    def with_nodes(self, other: _Nodes) -> _Nodes:
        """Merge with other nodes, in order; the end of a ray comes behind a sample at the same range."""
        both = _Nodes.stacked([self, other])
        return both.select(by_ray_and_range(both.rows, torch.where(both.kind == _FAR, both.k + _BEHIND_M, both.k)))

    def wanted(self, count: int, settings: RenderSettings) -> tuple[Tensor, _Nodes]:
        """Return a mask (K,) of the nodes to measure, and the places to sample. A NaN covers nothing."""
        sample = self.kind == _SAMPLE
        predicted = sample & (self.error > 0)
        lower = self._certain_distance(self.error, settings.max_step_m)
        left, right = self.kind[:-1], self.kind[1:]
        width = self.k[1:] - self.k[:-1]
        fall = (self.g[:-1] - self.g[1:]) / width.clamp_min(1e-12)
        slope = self._steepness(fall, count) / settings.step_safety
        between = width - (lower[:-1] + lower[1:]) / slope
        # In front of the return nothing may stay uncovered: the return itself is a sample, as in the paper.
        is_open = ~(between <= torch.where(right == _FAR, 0.0, settings.step_m))
        before = torch.where(sample[:-1], _fall_before(self.rows, self.k, torch.where(sample, self.g, 0.0))[:-1], 0.0)
        is_open &= ~((right == _HIT) & _is_clear_approach(width, self.g[:-1], lower[:-1], before, settings))
        if settings.local_minima:
            # For an interval that is closed only by the allowance `step_m`, a local slope decides.
            local = self._local_slope(fall)
            narrow = ~is_open & (lower[:-1] + lower[1:] < local * width) & (width > _NARROW_M) & (right == _SAMPLE)
            slope, is_open = torch.where(narrow, local, slope), is_open | narrow
            flat = (right == _INSIDE) & (fall < settings.approach_slope) & (width > settings.grazing_m)
            is_open |= flat
        # The node in front of a node inside must be measured to be outside.
        is_open |= (right == _INSIDE) & (predicted[:-1] | (left == _NEAR))
        is_open &= (self.rows[1:] == self.rows[:-1]) & (width > 0)
        measured = predicted & ~(self.g - self.error > _LOW_M)
        # An interval that even exact ends would leave open is sampled, else its predicted ends are measured.
        ends = is_open & (predicted[:-1] | predicted[1:])
        exact = self._certain_distance(torch.zeros_like(self.g), settings.max_step_m)
        ends &= (width - (exact[:-1] + exact[1:]) / slope <= settings.step_m) | (left != _SAMPLE)
        ends |= is_open & (right == _INSIDE)
        measured[:-1] |= ends & predicted[:-1]
        measured[1:] |= ends & predicted[1:]
        # Nodes behind the first node that is predicted inside are probably hidden: measure that node first.
        inside = predicted & (self.g < 0)
        first = torch.full((count,), torch.inf, dtype=torch.float64)
        behind = self.k > first.scatter_reduce(0, self.rows[inside], self.k[inside], "amin")[self.rows]
        measured &= ~behind
        at = torch.nonzero(is_open & ~measured[:-1] & ~measured[1:] & ~behind[1:]).squeeze(1)
        return measured, self._places(at, slope, lower)

    def _steepness(self, fall: Tensor, count: int) -> Tensor:
        """Return, per interval (K - 1,), the steepest slope measured on its ray, from 1 to `_STEEPEST`."""
        known = (self.error == 0) & ((self.kind == _SAMPLE) | (self.kind == _INSIDE))
        both = known[:-1] & known[1:] & (self.rows[1:] == self.rows[:-1])
        steepest = torch.ones(count, dtype=torch.float64)
        steepest = steepest.scatter_reduce(0, self.rows[:-1][both], fall[both].abs(), "amax")
        return steepest.clamp_max(_STEEPEST)[self.rows[:-1]]

    def _local_slope(self, fall: Tensor) -> Tensor:
        """Return, per interval (K - 1,), a bound on its slope; next to a local minimum from the adjacent intervals."""
        joined = (self.kind[:-1] == _SAMPLE) & (self.kind[1:] == _SAMPLE) & (self.rows[1:] == self.rows[:-1])
        s = torch.where(joined, fall, torch.nan)
        nothing = s.new_full((1,), torch.nan)
        before, after = torch.cat((nothing, s)), torch.cat((s, nothing))  # slopes before and after each node
        ends = torch.zeros_like(before, dtype=torch.bool)
        ends[:-1] = (self.kind[1:] == _FAR) & (self.rows[1:] == self.rows[:-1])
        lowest = (before >= 0) & ((after <= 0) | ends) & (self.kind == _SAMPLE)
        steep = _STEEPER * torch.maximum(before.abs(), torch.where(ends, 0.0, after.abs()))
        steep = torch.where(lowest, steep, 2.0 * _FLATTEST).clamp(_FLATTEST, 1.0)
        return torch.where(joined, torch.maximum(steep[:-1], steep[1:]), 0.0)

    def _certain_distance(self, error: Tensor, most_m: float) -> Tensor:
        """Return (K,) the certain part of |g| for error bounds (K,), metres, at most most_m; 0 at the ends of rays."""
        # most_m, because a learned field says little about far distances.
        certain = torch.where(self.kind == _SAMPLE, self.g - error, 0.0).clamp(0.0, most_m)
        return torch.where(self.kind == _INSIDE, self.g.abs().clamp_max(most_m), certain)

    def _places(self, at: Tensor, slope: Tensor, lower: Tensor) -> _Nodes:
        """Choose where to sample intervals (left nodes `at`): at the least lower bound, or at an end of the ray."""
        k, other = self.k[at], self.k[at + 1]
        share = 0.5 + 0.5 * (lower[at] - lower[at + 1]) / (slope[at] * (other - k)).clamp_min(1e-12)
        place = k + share.clamp(0.05, 0.95) * (other - k)
        place = torch.where(self.kind[at] == _NEAR, k, torch.where(self.kind[at + 1] == _FAR, other, place))
        both = (self.kind[at] == _SAMPLE) & (self.kind[at + 1] == _SAMPLE)
        expected = torch.where(both, 0.5 * (self.g[at] + self.g[at + 1]), torch.nan)
        return replace(_Nodes.empty(self.rows[at], place, torch.full_like(at, _SAMPLE)), g=expected)

    def with_measured(self, at: Tensor, g: Tensor, count: int) -> _Nodes:
        """Set measured values g at nodes `at`. A value below its prediction lowers its ray's predictions as much."""
        off = torch.zeros(count, dtype=torch.float64)
        off = off.scatter_reduce(0, self.rows[at], (g - self.g[at]).nan_to_num(nan=0.0), "amin")
        lower = torch.where((self.error > 0) & (self.kind == _SAMPLE), self.g + off[self.rows], self.g)
        return replace(self, g=lower.index_copy(0, at, g), error=self.error.index_fill(0, at, 0.0))

    def up_to_first_inside(self, count: int) -> _Nodes:
        """Cut every ray at its first measured sample inside, which becomes its end."""
        inside = (self.kind == _SAMPLE) & (self.error == 0) & (self.g < 0) | (self.kind == _INSIDE)
        first = torch.full((count,), torch.inf, dtype=torch.float64)
        first = first.scatter_reduce(0, self.rows[inside], self.k[inside], "amin")[self.rows]
        last = inside & (self.k == first)
        last[1:] &= ~(last[:-1] & (self.rows[1:] == self.rows[:-1]))  # a place may have been sampled twice
        kind = torch.where(inside, _INSIDE, self.kind)
        return replace(self, kind=kind).select((self.k < first) | last)
