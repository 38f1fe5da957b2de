"""Starting from the previous rendering of the same object: what moved little is not searched again.

Between two steps of an attack a surface moves by millimetres or centimetres. A beam that hit is followed by
secant steps from its last range. A beam in free space is left alone while the surface cannot have come near: each
carries its clearance (the lowest g of its last march, where that was not a hit) and a drift, the sum of how far the
surface has moved since. For a moved pose the motion is known; for a changed shape it is measured, as the largest |g|
at last step's hits. A beam whose drift reaches half its clearance, or whose secant steps do not end on a surface
that faces it, is marched again, and every `warm_refresh` renderings all are.

Source: our choice: the paper renders every step afresh. What this misses is measured against that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.geometry.se3 import scene_from_object
from shift3d.render.beams import Beams
from shift3d.render.bounds import Box, checked_box
from shift3d.render.bracket import Brackets, first_brackets
from shift3d.render.culling import Rays
from shift3d.render.empty_space import EmptySpace, Leaps
from shift3d.render.fast import rays_in_box, solve
from shift3d.render.object_field import ObjectField
from shift3d.render.rendering import FirstHits
from shift3d.render.settings import RenderSettings

_MOTION_SAFETY = 1.5
_MOTION_FLOOR_M = 5e-4
_FOLLOW_M = 0.3
_SECANT_STEPS = 4


@dataclass(frozen=True)
class WarmStart:
    """What a rendering knows about its beams.

    Attributes:
        theta: (6,) pose it was rendered at.
        box: checked box of the object, object frame.
        box_drift_m: surface motion since the box was checked.
        rays: (M) beams through the box.
        range_m: (M,) float64 distance of the hit, NaN where none.
        residual_m: (M,) |metric g| there.
        slope: (M,) dg/dk at the hit.
        clearance_m: (M,) lowest g of the last march away from the hit, infinite where there is no dip.
        drift_m: (M,) surface motion since that march.
        age: warm renderings since everything was searched.
    """

    theta: Tensor
    box: Box
    box_drift_m: float
    rays: Rays
    range_m: Tensor
    residual_m: Tensor
    slope: Tensor
    clearance_m: Tensor
    drift_m: Tensor
    age: int


def cold_start(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    settings: RenderSettings,
    space: EmptySpace | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Search every beam through the checked box afresh; `space` is a map of this very field, if there is one."""
    box = checked_box(field, size_m, settings.box_margin_m) if space is None else space.box
    rays = rays_in_box(beams, theta, box)
    blank = torch.full((len(rays),), torch.nan, dtype=torch.float64)
    state = WarmStart(theta.detach().clone(), box, 0.0, rays, blank, blank, blank, blank, torch.zeros_like(blank), 0)
    rows = torch.arange(len(rays))
    leaps = None if space is None else space.leaps(rays)
    return _search(state, rows, blank.clone(), field, settings, leaps)


def warm_start(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    warm: WarmStart,
    settings: RenderSettings,
    space: EmptySpace | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Follow the hits of an earlier rendering and search only where it no longer vouches."""
    if warm.age >= settings.warm_refresh:
        return cold_start(beams, field, theta, size_m, settings, space)
    moved_m = _pose_motion(warm.theta, theta, warm.box)
    state = warm if moved_m == 0 else _carried_over(warm, rays_in_box(beams, theta, warm.box))
    rows = torch.nonzero(torch.isfinite(state.range_m)).squeeze(1)
    if len(rows) == 0 and space is None:
        # Nothing was hit, so nothing can tell how far the surface has moved.
        return cold_start(beams, field, theta, size_m, settings, space)
    followed, residual, slope, g_start = _follow(state, rows, field, settings)
    reshaped_m = 0.0
    if space is None and len(rows):
        # A map vouches for an unchanged shape; without one, part of this may be the pose's own motion.
        reshaped_m = _MOTION_SAFETY * float(g_start.abs().max()) + _MOTION_FLOOR_M
    drift = state.drift_m + (moved_m + reshaped_m)
    box_drift = state.box_drift_m + reshaped_m
    if box_drift > 0.5 * settings.box_margin_m:
        box = checked_box(field, size_m, settings.box_margin_m)
        if bool((box.lower < state.box.lower).any() | (box.upper > state.box.upper).any()):
            return cold_start(beams, field, theta, size_m, settings, space)
        box_drift = 0.0
    ranges = torch.full_like(state.range_m, torch.nan)
    ranges[rows] = followed
    residuals, slopes = state.residual_m.clone(), state.slope.clone()
    residuals[rows], slopes[rows] = residual, slope
    lost = torch.zeros(len(ranges), dtype=torch.bool)
    lost[rows] = torch.isnan(followed)
    leaps = None if space is None else space.leaps(state.rays)
    again = torch.nonzero(lost | _in_doubt(state, ranges, drift, leaps)).squeeze(1)
    state = replace(
        state,
        theta=theta.detach().clone(),
        box_drift_m=box_drift,
        residual_m=residuals,
        slope=slopes,
        drift_m=drift,
        age=warm.age + 1,
    )
    return _search(state, again, ranges, field, settings, leaps)


def _in_doubt(state: WarmStart, ranges: Tensor, drift: Tensor, leaps: Leaps | None) -> Tensor:
    """(M,) rays that may meet a surface which was not there, or not first, before.

    With a map of the field, a ray without a cell that may hold surface is clear, and a hit stands if it lies where
    such cells begin and the ray did not pass another surface when it was last marched.
    """
    by_clearance = ~(drift < 0.5 * state.clearance_m)
    if leaps is None:
        return by_clearance
    first = leaps.first()
    stands = (ranges - first < _FOLLOW_M) & torch.isinf(state.clearance_m)
    return by_clearance & torch.isfinite(first) & ~stands


def _search(
    state: WarmStart,
    rows: Tensor,
    ranges: Tensor,
    field: ObjectField,
    settings: RenderSettings,
    leaps: Leaps | None,
) -> tuple[FirstHits, WarmStart]:
    """March some rows, find their roots, and put them together with the ranges already known."""
    rays = state.rays.select(rows)
    brackets = first_brackets(rays, field, settings, None if leaps is None else leaps.select(rows))
    found = torch.nonzero(brackets.found).squeeze(1)
    roots = solve(rays, found, brackets, field, settings)
    settled = roots.settled
    ranges[rows] = torch.nan
    ranges[rows[found[settled]]] = roots.k[settled]
    residual, slope = state.residual_m.clone(), state.slope.clone()
    clearance, drift = state.clearance_m.clone(), state.drift_m.clone()
    residual[rows[found]] = roots.residual
    slope[rows[found]] = _bracket_slope(brackets, found)
    # A miss that leapt over all it could have met was never near enough to know by how much.
    unknown = ~brackets.found & torch.isinf(brackets.clearance)
    clearance[rows], drift[rows] = torch.where(unknown, 0.0, brackets.clearance), 0.0
    undecided = brackets.undecided.clone()
    undecided[found[~settled]] = True
    state = replace(state, range_m=ranges, residual_m=residual, slope=slope, clearance_m=clearance, drift_m=drift)
    hit = torch.nonzero(torch.isfinite(ranges)).squeeze(1)
    hits = FirstHits(state.rays.index[hit], ranges[hit], residual[hit], rays.index[undecided])
    return hits, state


def _bracket_slope(brackets: Brackets, rows: Tensor) -> Tensor:
    rise = brackets.g_inner[rows] - brackets.g_outer[rows]
    return rise / (brackets.inner[rows] - brackets.outer[rows]).clamp_min(1e-12)


def _follow(
    state: WarmStart, rows: Tensor, field: ObjectField, settings: RenderSettings
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Secant steps from the last ranges: (ranges or NaN, |g| there, slopes, g at the start)."""
    rays = state.rays.select(rows)
    k, slope = state.range_m[rows].clone(), state.slope[rows].clone()
    start = torch.minimum(torch.maximum(k, rays.near_m), rays.far_m)
    k = start.clone()
    g = field(rays.at(k)).double()
    g_start = g.clone()
    active = torch.nonzero(g.abs() > settings.tolerance_m).squeeze(1)
    for _ in range(_SECANT_STEPS):
        if len(active) == 0:
            break
        k_old, g_old = k[active], g[active]
        k_new = k_old - g_old / slope[active].clamp_max(-0.02)
        g_new = field(rays.at(k_new, active)).double()
        step = k_new - k_old
        slope[active] = torch.where(step.abs() > 1e-9, (g_new - g_old) / step, slope[active])
        k[active], g[active] = k_new, g_new
        active = active[(g_new.abs() > settings.tolerance_m) & ((k_new - start[active]).abs() < _FOLLOW_M)]
    good = (g.abs() <= settings.tolerance_m) & ((k - start).abs() < _FOLLOW_M) & (slope < 0)
    good &= (k >= rays.near_m) & (k <= rays.far_m)
    return torch.where(good, k, torch.nan), g.abs(), slope, g_start


def _pose_motion(before: Tensor, after: Tensor, box: Box) -> float:
    """How far any point of the box moves between two poses."""
    before, after = before.detach().double(), after.detach().double()
    if torch.equal(before, after):
        return 0.0
    corners = torch.cartesian_prod(*torch.stack((box.lower, box.upper), 1))
    return float((scene_from_object(corners, before) - scene_from_object(corners, after)).norm(dim=-1).max())


def _carried_over(warm: WarmStart, rays: Rays) -> WarmStart:
    """The state on another set of rays: beams that are new have no clearance and will be searched."""
    count = int(max(warm.rays.index.max(), rays.index.max())) + 1 if len(rays) and len(warm.rays) else 0
    row_of = torch.full((count,), -1, dtype=torch.long)
    if count:
        row_of[warm.rays.index] = torch.arange(len(warm.rays))
    source = row_of[rays.index] if count else torch.full((len(rays),), -1, dtype=torch.long)
    known = source >= 0

    def carry(values: Tensor) -> Tensor:
        carried = torch.full((len(rays),), torch.nan, dtype=torch.float64)
        carried[known] = values[source[known]]
        return carried

    return replace(
        warm,
        rays=rays,
        range_m=carry(warm.range_m),
        residual_m=carry(warm.residual_m),
        slope=carry(warm.slope),
        clearance_m=torch.nan_to_num(carry(warm.clearance_m), nan=0.0, posinf=torch.inf),
        drift_m=torch.nan_to_num(carry(warm.drift_m), nan=0.0),
    )
