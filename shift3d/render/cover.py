"""Rays that are known in parts are sampled where what is known does not cover them.

A march leaves a ray covered: what lies between two samples lies in the spheres of free space around them, but for
`step_m`. When the field has changed, what is expected of the samples covers less. The places between them that are
left open are sampled again, those of all rays at once, until every ray is covered or found to enter the object.

Source: our choice: sphere tracing (Hart 1996) takes one step of every ray at a time, from its start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.render.bracket import Brackets
from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField
from shift3d.render.profile import Profile
from shift3d.render.settings import RenderSettings

_ROUNDS = 24
_STEEPEST = 10.0
_LOW_M = 0.003
# A hit that is approached at such a slope for so long is not looked at in between, as with a map.
_PLAIN_SLOPE = 0.3
_PLAIN_M = 0.2
# The lowest sample on a ray's way is looked at where it is lower than this and so many steps before the hit.
_WATCHED_M = 0.05
_WATCHED_STEPS = 3
_SAMPLE, _NEAR, _FAR, _HIT, _INSIDE = range(5)


@dataclass(frozen=True)
class Covered:
    """What came of covering M rays.

    profile: of all of them, nothing behind a crossing. brackets: crossings that came up. looked: (M,) bool, where the
    field was evaluated. given_up: (M,) bool, rays that want a march from their start.
    """

    profile: Profile
    brackets: Brackets
    looked: Tensor
    given_up: Tensor


def cover(profile: Profile, rays: Rays, hit_m: Tensor, field: ObjectField, settings: RenderSettings) -> Covered:
    """Sample rays until spheres cover them up to their hit, or up to their end.

    Args:
        profile: what is expected along the rays, of some of them nothing.
        hit_m: (M,) range of a hit that is known, NaN where none is.

    Not differentiable.
    """
    end_m = torch.where(torch.isnan(hit_m), torch.inf, hit_m)
    profile = _watched(_thinned(profile.before(end_m), end_m), end_m - _WATCHED_STEPS * settings.step_m)
    nodes, done = _Nodes.of(profile, rays, hit_m), []
    looked, undecided, given_up = (torch.zeros(len(rays), dtype=torch.bool) for _ in range(3))
    for _ in range(_ROUNDS):
        measured, places = nodes.wanted(len(rays), settings)
        busy = torch.zeros_like(looked)
        busy[nodes.rows[measured]] = True
        busy[places.rows] = True
        done.append(nodes.select(~busy[nodes.rows]))
        measured, nodes = measured[busy[nodes.rows]], nodes.select(busy[nodes.rows])
        if len(nodes.rows) == 0:
            break
        looked |= busy
        at = torch.nonzero(measured).squeeze(1)
        rows, k = torch.cat((nodes.rows[at], places.rows)), torch.cat((nodes.k[at], places.k))
        g = field.estimate(rays.at(k, rows), torch.cat((nodes.g[at], places.g))).double()
        undecided[rows[~torch.isfinite(g)]] = True
        nodes.g[at], nodes.slack[at] = g[: len(at)], 0.0
        nodes = nodes.joined(replace(places, g=g[len(at) :]))
        nodes = nodes.select(~undecided[nodes.rows]).up_to_first_inside(len(rays))
    given_up[nodes.rows] = True
    nodes = _Nodes.stacked(done)
    brackets, starts_inside = _entries(nodes, rays, undecided)
    samples = nodes.select(nodes.kind == _SAMPLE)
    left = Profile.none().with_more(Profile(samples.rows, samples.k, samples.g, samples.slack))
    return Covered(left, brackets, looked, given_up | starts_inside)


def _is_plain(width_m: Tensor, g: Tensor) -> Tensor:
    """Whether a hit so far behind a place with so much free space is approached plainly."""
    return (width_m <= _PLAIN_M) & (g >= _PLAIN_SLOPE * width_m)


def _thinned(profile: Profile, end_m: Tensor) -> Profile:
    """The profile without expected samples behind one from which the hit (M,) is approached plainly."""
    plain = _is_plain(end_m[profile.rows] - profile.k, profile.g - profile.slack)
    first = torch.full_like(end_m, torch.inf).scatter_reduce(0, profile.rows[plain], profile.k[plain], "amin")
    return profile.select((profile.k <= first[profile.rows]) | (profile.slack == 0))


def _watched(profile: Profile, until_m: Tensor) -> Profile:
    """The profile with the lowest sample of each ray up to a range (M,), if it is low, not taken at its word.

    What is small changes between the points of a lattice, and comes up where there is little room.
    """
    low = (profile.k < until_m[profile.rows]) & (profile.g < _WATCHED_M)
    least = torch.full_like(until_m, torch.inf).scatter_reduce(0, profile.rows[low], profile.g[low], "amin")
    watched = low & (profile.slack > 0) & (profile.g == least[profile.rows])
    return replace(profile, slack=torch.where(watched, torch.maximum(profile.slack, profile.g), profile.slack))


def _entries(nodes: _Nodes, rays: Rays, undecided: Tensor) -> tuple[Brackets, Tensor]:
    """Brackets of the rays that end inside, and (M,) bool which of them have nothing in front of that."""
    at = torch.nonzero(nodes.kind == _INSIDE).squeeze(1)
    before = (at - 1).clamp_min(0)
    from_outside = (at > 0) & (nodes.rows[before] == nodes.rows[at]) & (nodes.kind[before] == _SAMPLE)
    starts_inside = torch.zeros_like(undecided)
    starts_inside[nodes.rows[at[~from_outside]]] = True
    at, before = at[from_outside], before[from_outside]
    found, rows = torch.zeros_like(undecided), nodes.rows[at]
    found[rows] = True
    outer, inner, g_outer, g_inner = (torch.zeros_like(rays.near_m) for _ in range(4))
    outer[rows], inner[rows] = nodes.k[before], nodes.k[at]
    g_outer[rows], g_inner[rows] = nodes.g[before], nodes.g[at]
    return Brackets(found, outer, inner, g_outer, g_inner, undecided), starts_inside


@dataclass(frozen=True)
class _Nodes:
    """Samples and the ends of rays, by ray and range: as in a profile, and (K,) what each is."""

    rows: Tensor
    k: Tensor
    g: Tensor
    slack: Tensor
    kind: Tensor

    @staticmethod
    def of(profile: Profile, rays: Rays, hit_m: Tensor) -> _Nodes:
        """The samples, and where rays begin and end."""
        every, is_hit = torch.arange(len(rays)), torch.isfinite(hit_m)
        end_m, kind = torch.where(is_hit, hit_m, rays.far_m), torch.where(is_hit, _HIT, _FAR)
        samples = _Nodes(profile.rows, profile.k, profile.g, profile.slack, torch.full_like(profile.rows, _SAMPLE))
        near = _Nodes.empty(every, rays.near_m, torch.full_like(every, _NEAR))
        return near.joined(samples).joined(_Nodes.empty(every, end_m, kind))

    @staticmethod
    def empty(rows: Tensor, k: Tensor, kind: Tensor) -> _Nodes:
        """Nodes that cover nothing."""
        return _Nodes(rows, k, torch.zeros_like(k), torch.zeros_like(k), kind)

    @staticmethod
    def stacked(parts: list[_Nodes]) -> _Nodes:
        """Nodes of different rays, each ray's in one piece."""
        return _Nodes(*(torch.cat(some) for some in zip(*(vars(part).values() for part in parts), strict=True)))

    def select(self, chosen: Tensor) -> _Nodes:
        return _Nodes(*(part[chosen] for part in vars(self).values()))

    def joined(self, other: _Nodes) -> _Nodes:
        """These nodes and others, in order: the end of a ray behind a sample at that very place."""
        both = _Nodes.stacked([self, other])
        order = torch.argsort(torch.where(both.kind == _FAR, both.k + 1e-9, both.k), stable=True)
        return both.select(order[torch.argsort(both.rows[order], stable=True)])

    def wanted(self, count: int, settings: RenderSettings) -> tuple[Tensor, _Nodes]:
        """Which nodes must be measured, and places to sample. A NaN covers nothing."""
        sample = self.kind == _SAMPLE
        unsure = sample & (self.slack > 0)
        covers = torch.where(sample, (self.g - self.slack).clamp_min(0.0), 0.0)
        left, right = self.kind[:-1], self.kind[1:]
        width = self.k[1:] - self.k[:-1]
        fall = (self.g[:-1] - self.g[1:]).abs() / width.clamp_min(1e-12)
        steep = torch.where((left == _SAMPLE) & (right != _FAR), fall, 1.0).clamp(1.0, _STEEPEST)
        before, after = (settings.step_safety * covers[side] / steep for side in (slice(-1), slice(1, None)))
        gap = width - before - after
        allowed = torch.where(unsure[:-1] | unsure[1:], settings.step_m + settings.warm_gap_m, settings.step_m)
        # The return itself is a sample, as the paper has it.
        allowed[right == _FAR] = 0.0
        plain = (right == _HIT) & _is_plain(width, covers[:-1])
        # What comes before a place inside must be known to be outside.
        entry = (right == _INSIDE) & (width > 0) & ((left == _NEAR) | unsure[:-1])
        wide = (self.rows[1:] == self.rows[:-1]) & ((~(gap <= allowed) & ~plain) | entry)
        measured = unsure & ~(self.g - self.slack > _LOW_M)
        measured[:-1] |= wide & unsure[:-1]
        measured[1:] |= wide & unsure[1:]
        # Behind the first place that is expected to be inside nothing may be seen: that one is asked first.
        expected = torch.full((count,), torch.inf, dtype=torch.float64)
        inside = unsure & (self.g < 0)
        expected = expected.scatter_reduce(0, self.rows[inside], self.k[inside], "amin")
        behind = self.k > expected[self.rows]
        measured &= ~behind
        at = torch.nonzero(wide & ~measured[:-1] & ~measured[1:] & ~behind[1:]).squeeze(1)
        k = self.k[at] + before[at] + 0.5 * gap[at]
        k = torch.where(left[at] == _NEAR, self.k[at], torch.where(right[at] == _FAR, self.k[at + 1], k))
        wanted = _Nodes.empty(self.rows[at], k, torch.full_like(at, _SAMPLE))
        between = sample[at] & sample[at + 1]
        return measured, replace(wanted, g=torch.where(between, 0.5 * (self.g[at] + self.g[at + 1]), torch.nan))

    def up_to_first_inside(self, count: int) -> _Nodes:
        """Every ray up to its first measured sample inside, which becomes its end."""
        inside = (self.kind == _SAMPLE) & (self.slack == 0) & (self.g < 0) | (self.kind == _INSIDE)
        first = torch.full((count,), torch.inf, dtype=torch.float64)
        first = first.scatter_reduce(0, self.rows[inside], self.k[inside], "amin")[self.rows]
        last = inside & (self.k == first)
        last[1:] &= ~(last[:-1] & (self.rows[1:] == self.rows[:-1]))  # a place may have been sampled twice
        kind = torch.where(inside, _INSIDE, self.kind)
        return replace(self, kind=kind).select((self.k < first) | last)
