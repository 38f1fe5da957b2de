"""The default solver: predict, correct, refine. Cold, with a grid of the field, and warm it is the same.

1. Predict samples and hits along every ray: from an SDF grid of this very field; from an earlier rendering, its
   linearizations at the hits and two coarse grids that say how the field has changed; or, where nothing is known, from
   sphere tracing.
2. Correct the predicted hits by secant or Newton steps.
3. Cover every ray up to its hit or its end (`coverage`). Crossings that come up are solved for their roots.

Where the field is a decoder's, hidden units that are off everywhere in the box are left out (`ObjectField.sliced`).

Source: our choice: the paper renders every step afresh. What this misses is measured against `reference`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.geometry.se3 import scene_from_object
from shift3d.render.beams import Beams
from shift3d.render.culling import Box, Rays, rays_in_box
from shift3d.render.field.bounding_box import VerifiedBox, verified_box
from shift3d.render.field.linearization import Linearization
from shift3d.render.field.object_field import LiveUnits, ObjectField, either
from shift3d.render.field.sdf_grid import ChangeGrid, SdfGrid
from shift3d.render.first_hits import FirstHits
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.corrector import Corrected, newton, predict, secant
from shift3d.render.solvers.ray_samples import RaySamples
from shift3d.render.solvers.refinement import refine
from shift3d.render.solvers.roots import find_roots
from shift3d.render.solvers.sphere_tracing import trace

_SAFETY = 1.5
_STILL_M = 0.05
_MOTION_REACH_M = 0.3
_GRID_REACH_M = 0.15
_SURVEYED = 8
"""Of so many predicted hits one is evaluated with every hidden unit."""


@dataclass(frozen=True)
class WarmStart:
    """What a rendering knows about its beams.

    Attributes:
        beams: the scene's beams.
        theta: (6,) pose it was rendered at.
        box: verified box of the object, object frame; None where a grid stood for it.
        rays: (M) beams through the box.
        range_m: (M,) float64 distance of the hit, NaN where none.
        residual_m: (M,) |metric g| there.
        slope: (M,) dg/dk at the hit.
        samples: in front of the hits, and all along the beams that met nothing.
        grid: of the field.
        live: hidden units that were on; None: all are evaluated.
        age: warm renderings since everything was searched.
        linearization: of the field at the hits; while a rendering is being made, at those hits for which the search
            has made it. None where no gradient was asked for.
    """

    beams: Beams
    theta: Tensor
    box: VerifiedBox | None
    rays: Rays
    range_m: Tensor
    residual_m: Tensor
    slope: Tensor
    samples: RaySamples
    grid: ChangeGrid
    live: LiveUnits = None
    age: int = 0
    linearization: Linearization | None = None

    def with_hits(self, rows: Tensor, found: Corrected) -> WarmStart:
        """With what a correction found on some rays."""
        parts = {"range_m": found.range_m, "residual_m": found.residual_m, "slope": found.slope}
        return replace(self, **{name: getattr(self, name).index_copy(0, rows, new) for name, new in parts.items()})


def _blank(beams: Beams, theta: Tensor, rays: Rays, grid: ChangeGrid, live: LiveUnits) -> WarmStart:
    nan = torch.full((len(rays),), torch.nan, dtype=torch.float64)
    return WarmStart(beams, theta.detach().clone(), None, rays, nan, nan, nan, RaySamples.none(), grid, live)


def cold_start(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    settings: RenderSettings,
    grid: SdfGrid | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Search every beam through the verified box afresh; `grid` is of this very field, if there is one."""
    if grid is not None:
        return _with_grid(beams, field, theta, settings, grid)
    box = verified_box(field, size_m, settings.box_margin_m)
    rays = rays_in_box(beams, theta, box.box)
    change, live = _survey(field, box.box, torch.empty(0, 3, dtype=torch.float64), settings)
    state = replace(_blank(beams, theta, rays, change, live), box=box)
    return _completed(state, field.sliced(live), settings, unknown=torch.ones(len(rays), dtype=torch.bool))


def _with_grid(
    beams: Beams, field: ObjectField, theta: Tensor, settings: RenderSettings, grid: SdfGrid
) -> tuple[FirstHits, WarmStart]:
    """Correct the crossings that the grid shows plainly, and refine what it leaves open."""
    rays = rays_in_box(beams, theta, grid.box)
    live = grid.live if settings.live_units else None
    state, readings = _blank(beams, theta, rays, ChangeGrid.of(grid.at, grid.box), live), grid.along(rays)
    rows, guess, slope = readings.crossings(settings.approach_slope)
    field = field.sliced(live)
    found = secant(rays.select(rows), guess, slope, field, settings, _GRID_REACH_M)
    of, k, g = readings.samples()
    samples = RaySamples.none().joined(RaySamples(of, k, g, torch.full_like(g, readings.error_m)))
    return _completed(replace(state.with_hits(rows, found), samples=samples), field, settings)


def warm_start(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    before: WarmStart,
    settings: RenderSettings,
    grid: SdfGrid | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Correct the hits of an earlier rendering, and refine its samples where they leave their rays open.

    With a grid of the field at hand a fresh search costs less, and is made; and so it is where the pose has moved by
    more than 5 cm, as beams then meet other parts of the object, and where the rendering was of other beams.
    """
    if grid is not None or before.age >= settings.warm_refresh or not beams.same_as(before.beams):
        return cold_start(beams, field, theta, size_m, settings, grid)
    box = before.box or verified_box(field, size_m, settings.box_margin_m)
    if _pose_motion(before.theta, theta, box.box) > _STILL_M:
        return cold_start(beams, field, theta, size_m, settings)
    # A shape that keeps standing on the ground changes its height a little.
    rays = rays_in_box(beams, theta, box.box)
    row_of = _rows_of(before.rays, rays)
    old = torch.nonzero(torch.isfinite(before.range_m) & (row_of >= 0)).squeeze(1)
    if len(old) == 0:
        # Nothing was hit, so nothing can tell how far the surface has moved.
        return cold_start(beams, field, theta, size_m, settings)
    hit = rays.select(row_of[old])
    guess_m, change = _predicted(before, old, hit, field)
    surveyed, live = _survey(field, box.box, hit.at(guess_m)[::_SURVEYED], settings)
    if float(surveyed.variation(before.grid).max()) > settings.warm_change_m:
        return cold_start(beams, field, theta, size_m, settings)
    live = either(before.live, live)
    thin = field.sliced(live)
    if settings.final_newton_m > 0 and before.linearization is not None:
        found, linearization = newton(hit, guess_m, thin, settings, _MOTION_REACH_M)
    else:
        found, linearization = secant(hit, guess_m, before.slope[old], thin, settings, _MOTION_REACH_M), None
    moved_m = float(torch.nan_to_num((change + found.g_start).abs(), nan=torch.inf).max())
    box = box.after(field, _SAFETY * moved_m)
    if not box.holds:
        box = box.grown(field, settings.box_margin_m)
        rays = rays_in_box(beams, theta, box.box)
        row_of = _rows_of(before.rays, rays)
        surveyed, more = _survey(field, box.box, torch.empty(0, 3, dtype=torch.float64), settings)
        live = either(live, more)
        thin = field.sliced(live)
    state = replace(_blank(beams, theta, rays, surveyed, live), box=box).with_hits(row_of[old], found)
    samples = before.samples.predicted(before.rays, rays, row_of, before.grid, state.grid, settings.prediction_error)
    state = replace(state, samples=samples, age=before.age + 1, linearization=linearization)
    known = torch.isfinite(state.range_m)
    known[samples.rows] = True
    return _completed(state, thin, settings, unknown=~known)


def _predicted(before: WarmStart, old: Tensor, rays: Rays, field: ObjectField) -> tuple[Tensor, Tensor]:
    """(M,) ranges at which the rays of old hits are expected to meet the surface; (M,) by how much g changed there."""
    guess_m, change = before.range_m[old].clone(), torch.zeros(len(old), dtype=torch.float64)
    if before.linearization is not None:
        of = before.linearization.rows_of(rays.index)
        linearized = torch.nonzero(of >= 0).squeeze(1)
        predicted_m, changed = predict(before.linearization.select(of[linearized]), rays.select(linearized), field)
        near = (predicted_m - guess_m[linearized]).abs() < _MOTION_REACH_M
        guess_m[linearized[near]], change[linearized[near]] = predicted_m[near], changed[near]
    return guess_m, change


def _survey(field: ObjectField, box: Box, more: Tensor, settings: RenderSettings) -> tuple[ChangeGrid, LiveUnits]:
    """The change grid of a box, and the hidden units that are on at its nodes or at some more places (n, 3)."""
    first, nodes, shape = ChangeGrid.nodes(box)
    g, live = field.survey(torch.cat((nodes, more)))
    return ChangeGrid(first, g[: len(nodes)].float().reshape(shape)), live if settings.live_units else None


def _completed(
    state: WarmStart, field: ObjectField, settings: RenderSettings, unknown: Tensor | None = None
) -> tuple[FirstHits, WarmStart]:
    """Refine every ray, and put its crossings together with the hits already known.

    unknown: (M,) bool, rays to trace first. Rays that stay open, as they begin inside, are traced, too.
    """
    every = torch.ones(len(state.rays), dtype=torch.bool)
    state, undecided = _traced(state, ~every if unknown is None else unknown, field, settings)
    state, lost, left = _refined(state, every & ~undecided, field, settings)
    undecided |= lost
    if bool(left.any()):
        state, lost = _traced(state, left, field, settings)
        state, more, left = _refined(state, left & ~lost, field, settings)
        undecided |= lost | more | left
    ranges = torch.where(undecided, torch.nan, state.range_m)
    # What lies closer together tells a later rendering little more.
    state = replace(
        state,
        range_m=ranges,
        samples=state.samples.before(ranges.nan_to_num(nan=torch.inf)).thinned(settings.step_m / 2),
    )
    hit = torch.nonzero(torch.isfinite(ranges)).squeeze(1)
    index = state.rays.index
    return FirstHits(index[hit], ranges[hit], state.residual_m[hit], index[undecided]), state


def _traced(state: WarmStart, chosen: Tensor, field: ObjectField, settings: RenderSettings) -> tuple[WarmStart, Tensor]:
    """Forget what is known of some rays (M,) bool and trace them. (M,) bool: which of them cannot be decided."""
    rows, undecided = torch.nonzero(chosen).squeeze(1), torch.zeros_like(chosen)
    if len(rows) == 0:
        return state, undecided
    traced = trace(state.rays.select(rows), field, settings)
    undecided[rows] = traced.undecided
    rays = replace(state.rays, near_m=state.rays.near_m.index_copy(0, rows, traced.near_m))
    samples = replace(traced.samples, rows=rows[traced.samples.rows])
    samples = state.samples.select(~chosen[state.samples.rows]).joined(samples)
    ranges = torch.where(chosen, torch.nan, state.range_m)
    return replace(state, rays=rays, samples=samples, range_m=ranges), undecided


def _refined(
    state: WarmStart, chosen: Tensor, field: ObjectField, settings: RenderSettings
) -> tuple[WarmStart, Tensor, Tensor]:
    """Cover some rays (M,) bool and solve their crossings. (M,) bool: which are undecided, and which are left open."""
    rows = torch.nonzero(chosen).squeeze(1)
    number = torch.full((len(chosen),), -1, dtype=torch.long).index_copy(0, rows, torch.arange(len(rows)))
    mine = chosen[state.samples.rows]
    samples, others = state.samples.select(mine), state.samples.select(~mine)
    rays = state.rays.select(rows)
    refined = refine(replace(samples, rows=number[samples.rows]), rays, state.range_m[rows], field, settings)
    b = refined.brackets
    roots = find_roots(
        lambda k, at: field(rays.at(k, b.rows[at])),
        *(b.outer, b.inner, b.g_outer, b.g_inner, settings.tolerance_m, settings.max_iterations),
    )
    lost, left = torch.zeros_like(chosen), torch.zeros_like(chosen)
    lost[rows[refined.undecided]], lost[rows[b.rows[~roots.converged]]] = True, True
    left[rows[refined.open]] = True
    slope = (b.g_inner - b.g_outer) / (b.inner - b.outer).clamp_min(1e-12)
    state = state.with_hits(rows[b.rows], Corrected(roots.k, roots.residual, slope, b.g_outer))
    samples = others.joined(replace(refined.samples, rows=rows[refined.samples.rows]))
    return replace(state, samples=samples), lost, left & ~lost


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
