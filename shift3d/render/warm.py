"""Starting from the previous rendering of an object that changes its shape: what moved little is not searched again.

Between two steps of an attack a surface moves by millimetres or centimetres. A beam that hit is looked at where the
derivatives of the last step say that it will hit now (see `approach`), and followed by secant steps where that is not
near. A beam that came near the surface without meeting it, or before it met it, is looked at where it came nearest: it
is left alone while what is left there is more than what the field has lost there since the last march, half as much
again. Only the others are marched, and every `warm_refresh` renderings all are.

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
from shift3d.render.bracket import Brackets, first_brackets
from shift3d.render.culling import Rays
from shift3d.render.empty_space import EmptySpace, Leaps
from shift3d.render.fast import rays_in_box, solve
from shift3d.render.follow import follow
from shift3d.render.object_field import ObjectField
from shift3d.render.rendering import FirstHits
from shift3d.render.settings import RenderSettings
from shift3d.render.tangents import Tangents

_SAFETY = 1.5
_FLOOR_M = 0.003
_STILL_M = 0.05
_MOTION_REACH_M = 0.05
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
        clearance_m: (M,) lowest g away from the hit when it was last looked at; infinite where g only falls towards
            the hit, 0 where nothing is known.
        closest_m: (M,) range of that place.
        drift_m: (M,) how much g has changed there since the last march.
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
    clearance_m: Tensor
    closest_m: Tensor
    drift_m: Tensor
    age: int
    tangents: Tangents | None = None


def _blank(beams: Beams, theta: Tensor, guard: Guard | None, rays: Rays) -> WarmStart:
    nan = torch.full((len(rays),), torch.nan, dtype=torch.float64)
    zero = torch.zeros_like(nan)
    return WarmStart(
        beams, theta.detach().clone(), guard, rays, nan, nan.clone(), nan.clone(), zero, rays.near_m, zero, 0
    )


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
    return _search(_blank(beams, theta, guard, rays), torch.arange(len(rays)), field, settings)


def _with_map(
    beams: Beams, field: ObjectField, theta: Tensor, settings: RenderSettings, space: EmptySpace
) -> tuple[FirstHits, WarmStart]:
    """Take the crossings that the map shows plainly, march where it is in doubt, leave the rest alone."""
    rays = rays_in_box(beams, theta, space.box)
    state, sight = _blank(beams, theta, None, rays), space.sight(rays)
    rows, guess, slope = sight.crossings()
    found = follow(rays.select(rows), guess, slope, field, settings, _MAP_REACH_M)
    state.range_m[rows], state.residual_m[rows], state.slope[rows] = found.range_m, found.residual_m, found.slope
    plain = torch.isfinite(state.range_m)
    clearance, closest = sight.closest()
    clearance = torch.where(plain, torch.inf, clearance)
    leaps = sight.leaps()
    doubtful = torch.nonzero(~plain & torch.isfinite(leaps.first())).squeeze(1)
    state = replace(state, clearance_m=clearance, closest_m=closest)
    return _search(state, doubtful, field, settings, leaps)


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
    state = _carried_over(warm, rays_in_box(beams, theta, guard.box))
    rows = torch.nonzero(torch.isfinite(state.range_m)).squeeze(1)
    if len(rows) == 0:
        # Nothing was hit, so nothing can tell how far the surface has moved.
        return cold_start(beams, field, theta, size_m, settings)
    then = state.range_m[rows], state.slope[rows]
    found, tangents = find_near(state.rays.select(rows), *then, warm.tangents, field, settings, _MOTION_REACH_M)
    moved_m = _SAFETY * float(torch.nan_to_num(found.g_start, nan=torch.inf).abs().max())
    ranges, residual, slope = state.range_m.clone(), state.residual_m.clone(), state.slope.clone()
    ranges[rows], residual[rows], slope[rows] = found.range_m, found.residual_m, found.slope
    state = replace(
        state,
        theta=theta.detach().clone(),
        range_m=ranges,
        residual_m=residual,
        slope=slope,
        age=warm.age + 1,
        tangents=tangents,
    )
    clearance, drift, doubt = _looked_at_again(state, field)
    doubt[rows] |= torch.isnan(found.range_m)
    guard = guard.after(field, moved_m)
    state = replace(state, clearance_m=clearance, drift_m=drift, guard=guard)
    if not guard.holds:
        guard = guard.grown(field, settings.box_margin_m)
        rays = rays_in_box(beams, theta, guard.box)
        state, doubt = _in_grown_box(state, doubt, guard, rays, field, settings)
    return _search(state, torch.nonzero(doubt).squeeze(1), field, settings)


def _in_grown_box(
    state: WarmStart, doubt: Tensor, guard: Guard, rays: Rays, field: ObjectField, settings: RenderSettings
) -> tuple[WarmStart, Tensor]:
    """The state on the rays of a box that has grown, and which of them are in doubt.

    In doubt is also what is new; what had no hit and is longer now; and what meets something on the stretch that the
    box has added in front. What comes near something there remembers it.
    """
    source = _rows_before(state.rays, rays)
    known, at = source >= 0, source.clamp_min(0)
    hit, entry = known & torch.isfinite(state.range_m[at]), state.rays.near_m[at]
    longer = (rays.near_m < entry) | (rays.far_m > state.rays.far_m[at])
    doubt = ~known | doubt[at] | (longer & ~hit)
    rows = torch.nonzero((rays.near_m < entry) & ~doubt).squeeze(1)
    added = first_brackets(replace(rays.select(rows), far_m=entry[rows]), field, settings)
    doubt[rows] = added.found | added.undecided
    state = _carried_over(state, rays)
    clearance, closest, drift = state.clearance_m.clone(), state.closest_m.clone(), state.drift_m.clone()
    nearer = (added.clearance < clearance[rows]) & (added.closest < entry[rows])
    rows = rows[nearer]
    clearance[rows], closest[rows], drift[rows] = added.clearance[nearer], added.closest[nearer], 0.0
    return replace(state, guard=guard, clearance_m=clearance, closest_m=closest, drift_m=drift), doubt


def _looked_at_again(state: WarmStart, field: ObjectField) -> tuple[Tensor, Tensor, Tensor]:
    """(M,) clearance and drift as they are now, and which rays may meet a surface that was not there before."""
    clearance, drift = state.clearance_m.clone(), state.drift_m.clone()
    near = torch.nonzero(torch.isfinite(clearance) & (clearance > 0)).squeeze(1)
    k = torch.minimum(torch.maximum(state.closest_m[near], state.rays.near_m[near]), state.rays.far_m[near])
    g = field.estimate(state.rays.at(k, near)).double()
    drift[near] += (g - clearance[near]).abs()
    clearance[near] = g
    return clearance, drift, ~(clearance > _SAFETY * drift + _FLOOR_M)


def _search(
    state: WarmStart, rows: Tensor, field: ObjectField, settings: RenderSettings, leaps: Leaps | None = None
) -> tuple[FirstHits, WarmStart]:
    """March some rows, find their roots, and put them together with the ranges already known."""
    rays = state.rays.select(rows)
    brackets = first_brackets(rays, field, settings, None if leaps is None else leaps.select(rows))
    found = torch.nonzero(brackets.found).squeeze(1)
    roots = solve(rays, found, brackets, field, settings)
    settled = roots.settled
    ranges, residual, slope = state.range_m.clone(), state.residual_m.clone(), state.slope.clone()
    clearance, closest, drift = state.clearance_m.clone(), state.closest_m.clone(), state.drift_m.clone()
    ranges[rows] = torch.nan
    ranges[rows[found[settled]]] = roots.k[settled]
    residual[rows[found]], slope[rows[found]] = roots.residual, _bracket_slope(brackets, found)
    # A miss that leapt over all it could have met was never near enough to know by how much.
    unknown = ~brackets.found & torch.isinf(brackets.clearance)
    clearance[rows], drift[rows] = torch.where(unknown, 0.0, brackets.clearance), 0.0
    closest[rows] = brackets.closest
    undecided = brackets.undecided.clone()
    undecided[found[~settled]] = True
    state = replace(
        state,
        range_m=ranges,
        residual_m=residual,
        slope=slope,
        clearance_m=clearance,
        closest_m=closest,
        drift_m=drift,
    )
    hit = torch.nonzero(torch.isfinite(ranges)).squeeze(1)
    hits = FirstHits(state.rays.index[hit], ranges[hit], residual[hit], rays.index[undecided])
    return hits, state


def _bracket_slope(brackets: Brackets, rows: Tensor) -> Tensor:
    rise = brackets.g_inner[rows] - brackets.g_outer[rows]
    return rise / (brackets.inner[rows] - brackets.outer[rows]).clamp_min(1e-12)


def _pose_motion(before: Tensor, after: Tensor, box: Box) -> float:
    """How far any point of the box moves between two poses."""
    corners = torch.cartesian_prod(*torch.stack((box.lower, box.upper), 1))
    there, here = (scene_from_object(corners, theta.detach().double()) for theta in (before, after))
    return float((there - here).norm(dim=-1).max())


def _rows_before(before: Rays, rays: Rays) -> Tensor:
    """(M,) which of the rays before each ray is, -1 where it is none of them."""
    if len(before) == 0 or len(rays) == 0:
        return torch.full((len(rays),), -1, dtype=torch.long)
    row_of = torch.full((int(max(before.index.max(), rays.index.max())) + 1,), -1, dtype=torch.long)
    row_of[before.index] = torch.arange(len(before))
    return row_of[rays.index]


def _carried_over(warm: WarmStart, rays: Rays) -> WarmStart:
    """The state on another set of rays: beams that are new have no clearance and will be searched."""
    if torch.equal(warm.rays.index, rays.index):
        return replace(warm, rays=rays)
    source = _rows_before(warm.rays, rays)
    known = source >= 0

    def carry(values: Tensor, new: float) -> Tensor:
        carried = torch.full((len(rays),), new, dtype=torch.float64)
        carried[known] = values[source[known]]
        return carried

    return replace(
        warm,
        rays=rays,
        range_m=carry(warm.range_m, torch.nan),
        residual_m=carry(warm.residual_m, torch.nan),
        slope=carry(warm.slope, torch.nan),
        clearance_m=carry(warm.clearance_m, 0.0),
        closest_m=torch.where(known, carry(warm.closest_m, 0.0), rays.near_m),
        drift_m=carry(warm.drift_m, 0.0),
    )
