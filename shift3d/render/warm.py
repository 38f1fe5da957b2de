"""Starting from the previous rendering of an object that changes its shape: what moved little is not searched again.

Between two steps of an attack a surface moves by millimetres or centimetres. A beam that hit is looked at where the
derivatives of the last step say that it will hit now (see `approach`), and followed by secant steps where that is not
near. In front of its hit, and along a beam that met nothing, the samples of the last search go on to vouch for free
space: a coarse lattice says what has become of them (see `profile`), and where they no longer cover the beam it is
sampled again (see `cover`). Only beams that this does not settle, such as those that begin inside the object, are
marched, and every `warm_refresh` renderings all are.

Source: our choice: the paper renders every step afresh. What this misses is measured against that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.geometry.se3 import scene_from_object
from shift3d.render.approach import find_near
from shift3d.render.beams import Beams
from shift3d.render.bounds import Box, Guard, guarded_box
from shift3d.render.bracket import Brackets, first_brackets, looked_into
from shift3d.render.cover import cover
from shift3d.render.culling import Rays
from shift3d.render.empty_space import EmptySpace, Leaps
from shift3d.render.fast import rays_in_box, solve
from shift3d.render.follow import follow
from shift3d.render.lattice import FieldLattice
from shift3d.render.object_field import ObjectField
from shift3d.render.profile import Profile
from shift3d.render.rendering import FirstHits
from shift3d.render.seen import Seen
from shift3d.render.settings import RenderSettings
from shift3d.render.tangents import Tangents

_SAFETY = 1.5
_STILL_M = 0.05
_MOTION_REACH_M = 0.3
_MAP_REACH_M = 0.15


@dataclass(frozen=True)
class WarmStart:
    """What a rendering knows about its beams.

    Attributes:
        beams: the scene's beams.
        theta: (6,) pose it was rendered at.
        guard: checked box of the object, object frame; None where a map stood for it.
        rays: (M) beams through the box.
        range_m: (M,) float64 distance of the hit, NaN where none.
        residual_m: (M,) |metric g| there.
        slope: (M,) dg/dk at the hit.
        profile: samples in front of the hits, and all along the beams that met nothing.
        lattice: of the field.
        age: warm renderings since everything was searched.
        tangents: the field about the hits, to first order; while a rendering is being made, about those of its hits
            for which the search has made them. None where no gradient was asked for.
    """

    beams: Beams
    theta: Tensor
    guard: Guard | None
    rays: Rays
    range_m: Tensor
    residual_m: Tensor
    slope: Tensor
    profile: Profile
    lattice: FieldLattice
    age: int
    tangents: Tangents | None = None


def _blank(beams: Beams, theta: Tensor, guard: Guard | None, rays: Rays, lattice: FieldLattice) -> WarmStart:
    nan = torch.full((len(rays),), torch.nan, dtype=torch.float64)
    theta = theta.detach().clone()
    return WarmStart(beams, theta, guard, rays, nan, nan.clone(), nan.clone(), Profile.none(), lattice, 0)


def cold_start(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    settings: RenderSettings,
    space: EmptySpace | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Search every beam through the checked box afresh; `space` is a map of this very field, if there is one."""
    if space is not None:
        return _with_map(beams, field, theta, settings, space)
    guard = guarded_box(field, size_m, settings.box_margin_m)
    rays = rays_in_box(beams, theta, guard.box)
    state = _blank(beams, theta, guard, rays, FieldLattice.of(field.estimate, guard.box))
    return _settled(state, [_marched(state.rays, torch.arange(len(rays)), field, settings)], field, settings)


def _with_map(
    beams: Beams, field: ObjectField, theta: Tensor, settings: RenderSettings, space: EmptySpace
) -> tuple[FirstHits, WarmStart]:
    """Take the crossings that the map shows plainly, march where it is in doubt, leave the rest alone."""
    rays = rays_in_box(beams, theta, space.box)
    state, sight = _blank(beams, theta, None, rays, FieldLattice.of(space.at, space.box)), space.sight(rays)
    rows, guess, slope = sight.crossings()
    found = follow(rays.select(rows), guess, slope, field, settings, _MAP_REACH_M)
    state.range_m[rows], state.residual_m[rows], state.slope[rows] = found.range_m, found.residual_m, found.slope
    leaps = sight.leaps()
    doubtful = torch.nonzero(torch.isnan(state.range_m) & torch.isfinite(leaps.first())).squeeze(1)
    rows, k, g = sight.samples()
    state = replace(state, profile=Profile(rows, k, g, torch.full_like(g, sight.doubt_m)))
    return _settled(state, [_marched(rays, doubtful, field, settings, leaps.select(doubtful))], field, settings)


def warm_start(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    warm: WarmStart,
    settings: RenderSettings,
    space: EmptySpace | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Follow the hits of an earlier rendering and search only where it no longer vouches.

    With a map of the field at hand a fresh search costs less than following, and is made; and so it is where the pose
    has moved by more than 5 cm, as beams then meet other parts of the object, and where the rendering was of others.
    """
    if space is not None or warm.age >= settings.warm_refresh or not beams.same_as(warm.beams):
        return cold_start(beams, field, theta, size_m, settings, space)
    guard = warm.guard or guarded_box(field, size_m, settings.box_margin_m)
    if _pose_motion(warm.theta, theta, guard.box) > _STILL_M:
        return cold_start(beams, field, theta, size_m, settings)
    # A shape that keeps standing on the ground changes its height a little.
    rays = rays_in_box(beams, theta, guard.box)
    row_of = _rows_of(warm.rays, rays)
    old = torch.nonzero(torch.isfinite(warm.range_m) & (row_of >= 0)).squeeze(1)
    if len(old) == 0:
        # Nothing was hit, so nothing can tell how far the surface has moved.
        return cold_start(beams, field, theta, size_m, settings)
    then = rays.select(row_of[old]), warm.range_m[old], warm.slope[old]
    found, tangents = find_near(*then, warm.tangents, field, settings, _MOTION_REACH_M)
    guard = guard.after(field, _SAFETY * float(torch.nan_to_num(found.g_start, nan=torch.inf).abs().max()))
    if not guard.holds:
        guard = guard.grown(field, settings.box_margin_m)
        rays = rays_in_box(beams, theta, guard.box)
        row_of = _rows_of(warm.rays, rays)
    state, rows = _blank(beams, theta, guard, rays, FieldLattice.of(field.estimate, guard.box)), row_of[old]
    state.range_m[rows], state.residual_m[rows], state.slope[rows] = found.range_m, found.residual_m, found.slope
    profile = warm.profile.carried(warm.rays, rays, row_of, warm.lattice, state.lattice)
    state = replace(state, profile=profile, age=warm.age + 1, tangents=tangents)
    state, searches = _searched(state, field, settings)
    return _settled(state, searches, field, settings)


@dataclass(frozen=True)
class _Search:
    """What a search found on some rays: rows (m,), which they are; their brackets; and what it saw of them."""

    rows: Tensor
    brackets: Brackets
    seen: Profile


def _marched(
    rays: Rays, rows: Tensor, field: ObjectField, settings: RenderSettings, leaps: Leaps | None = None
) -> _Search:
    """March some rays."""
    seen = Seen()
    brackets = first_brackets(rays.select(rows), field, settings, leaps, seen)
    return _Search(rows, brackets, Profile.of(seen, rows))


def _searched(state: WarmStart, field: ObjectField, settings: RenderSettings) -> tuple[WarmStart, list[_Search]]:
    """Look where a state no longer vouches for what is in front of its hits and along its misses, or knows nothing."""
    rays = state.rays
    covered = cover(state.profile, rays, state.range_m, field, settings)
    profile = covered.profile.of_rays(~covered.given_up)
    rows = torch.nonzero(covered.looked & ~covered.given_up).squeeze(1)
    looked = _between(rays, rows, covered.brackets.select(rows), profile, field, settings)
    marched = _marched(rays, torch.nonzero(covered.given_up).squeeze(1), field, settings)
    return replace(state, profile=profile), [looked, marched]


def _between(
    rays: Rays, rows: Tensor, brackets: Brackets, profile: Profile, field: ObjectField, settings: RenderSettings
) -> _Search:
    """What lies between the samples of some rays."""
    local = torch.full((len(rays),), -1, dtype=torch.long)
    local[rows] = torch.arange(len(rows))
    samples = profile.select(local[profile.rows] >= 0)
    seen = Seen()
    seen.add(local[samples.rows], samples.k, samples.g)
    brackets = looked_into(brackets, seen, rays.select(rows), field, settings)
    return _Search(rows, brackets, Profile.of(seen, rows, len(samples)))


def _settled(
    state: WarmStart, searches: list[_Search], field: ObjectField, settings: RenderSettings
) -> tuple[FirstHits, WarmStart]:
    """Find the roots in what searches found, and put them together with the hits already known."""
    ranges, residual, slope = state.range_m.clone(), state.residual_m.clone(), state.slope.clone()
    profile, unresolved = state.profile, torch.zeros(len(ranges), dtype=torch.bool)
    for search in searches:
        rows, brackets = search.rows, search.brackets
        found = torch.nonzero(brackets.found).squeeze(1)
        roots = solve(state.rays.select(rows), found, brackets, field, settings)
        undecided = brackets.undecided.clone()
        undecided[found[~roots.settled]] = True
        ranges[rows[found]] = roots.k
        residual[rows[found]], slope[rows[found]] = roots.residual, _bracket_slope(brackets, found)
        ranges[rows[undecided]], unresolved[rows[undecided]] = torch.nan, True
        profile = profile.with_more(search.seen)
    profile = profile.before(torch.where(torch.isnan(ranges), torch.inf, ranges))
    state = replace(state, range_m=ranges, residual_m=residual, slope=slope, profile=profile)
    hit = torch.nonzero(torch.isfinite(ranges)).squeeze(1)
    hits = FirstHits(state.rays.index[hit], ranges[hit], residual[hit], state.rays.index[unresolved])
    return hits, state


def _bracket_slope(brackets: Brackets, rows: Tensor) -> Tensor:
    rise = brackets.g_inner[rows] - brackets.g_outer[rows]
    return rise / (brackets.inner[rows] - brackets.outer[rows]).clamp_min(1e-12)


def _pose_motion(before: Tensor, after: Tensor, box: Box) -> float:
    """How far any point of the box moves between two poses."""
    corners = torch.cartesian_prod(*torch.stack((box.lower, box.upper), 1))
    there, here = (scene_from_object(corners, theta.detach().double()) for theta in (before, after))
    return float((there - here).norm(dim=-1).max())


def _rows_of(rays: Rays, others: Rays) -> Tensor:
    """(M,) which of some other rays each ray is, -1 where it is none of them."""
    if len(rays) == 0 or len(others) == 0:
        return torch.full((len(rays),), -1, dtype=torch.long)
    row_of = torch.full((int(max(rays.index.max(), others.index.max())) + 1,), -1, dtype=torch.long)
    row_of[others.index] = torch.arange(len(others))
    return row_of[rays.index]
