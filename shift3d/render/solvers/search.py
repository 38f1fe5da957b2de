"""Default solver: predict, correct, refine. The steps are the same for a cold start, for a grid, and for a warm start.

1. Predict samples and hits along every ray from an SDF grid of this very field; or from an earlier rendering, with its
linearizations at the hits and two coarse grids that tell the field's change; or else by sphere tracing.
2. Correct the predicted hits by secant or Newton steps.
3. Cover every ray up to its hit or its end (`refinement`), and solve the crossings that are found for their roots.

Hidden units of a decoder that are off everywhere in the box are left out (`ObjectField.sliced`).

Source: our choice: the paper renders every step from scratch. Errors of this solver are measured against `reference`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.render.beams import Beams, FirstHits
from shift3d.render.culling import Rays, rays_in_box, rows_of
from shift3d.render.field.bounding_box import VerifiedBox, verified_box
from shift3d.render.field.linearization import Linearization
from shift3d.render.field.object_field import LiveUnits, ObjectField, union_of_units
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.corrector import correct, predict
from shift3d.render.solvers.ray_samples import RaySamples
from shift3d.render.solvers.refinement import refine
from shift3d.render.solvers.roots import find_roots
from shift3d.render.solvers.sphere_tracing import trace

_SAFETY = 1.5
_STILL_M = 0.05
_MOTION_REACH_M = 0.3
_GRID_REACH_M = 0.15
_FALL = -0.5
"""Assumed dg/dk at a hit without further knowledge."""


@dataclass(frozen=True)
class WarmStart:
    """State of a rendering from which the next one can start.

    Attributes:
        beams: the scene's beams. theta: (6,) pose of the rendering.
        box: verified box of the object, object frame; None if a grid's box was used instead.
        rays: (M) beams through the box.
        range_m: (M,) float64 range of the hit, NaN if none. residual_m: (M,) |metric g| at the hit.
        samples: in front of the hits, and along the whole of rays without a hit.
        grid: coarse grid of the field. live: hidden units that were on; None: all are evaluated.
        undecided: (M,) bool, rays that cannot be decided.
        age: number of warm renderings since the last full search.
        linearization: of the field at the hits; during a rendering only at the hits for which the search has made it.
            None if no gradient was wanted.
    """

    beams: Beams
    theta: Tensor
    box: VerifiedBox | None
    rays: Rays
    range_m: Tensor
    residual_m: Tensor
    samples: RaySamples
    grid: SdfGrid
    live: LiveUnits
    undecided: Tensor
    age: int = 0
    linearization: Linearization | None = None

    @staticmethod
    def of(
        beams: Beams, theta: Tensor, rays: Rays, grid: SdfGrid, box: VerifiedBox | None, settings: RenderSettings
    ) -> WarmStart:
        """Create the state in which nothing is known of any ray."""
        nan, live = torch.full_like(rays.near_m, torch.nan), grid.live if settings.live_units else None
        theta, undecided = theta.detach().clone(), torch.zeros(len(rays), dtype=torch.bool)
        return WarmStart(beams, theta, box, rays, nan, nan, RaySamples.none(), grid, live, undecided)

    def with_hits(self, rows: Tensor, range_m: Tensor, residual_m: Tensor) -> WarmStart:
        """Return a copy with new hits on the given rays."""
        range_m, residual_m = self.range_m.index_copy(0, rows, range_m), self.residual_m.index_copy(0, rows, residual_m)
        return replace(self, range_m=range_m, residual_m=residual_m)


def first_hits(
    beams: Beams,
    field: ObjectField,
    theta: Tensor,
    size_m: Tensor,
    settings: RenderSettings,
    warm: WarmStart | None = None,
    grid: SdfGrid | None = None,
) -> tuple[FirstHits, WarmStart]:
    """Find the first crossing of g = 0 on every beam through the verified box. Also returns the next warm start.

    Args:
        field: metric distance in the object frame. size_m: (3,) size of the baseline's box.
        warm: state of an earlier rendering, if it may be used. grid: of this very field; preferred to `warm`.
    Not differentiable.
    """
    state = None
    if grid is not None:
        state = _from_grid(beams, field, theta, settings, grid)
    elif warm is not None:
        state = _from_earlier(beams, field, theta, size_m, settings, warm)
    if state is None:
        box = verified_box(field, size_m, settings.box_margin_m)
        coarse = SdfGrid.coarse(field, box.box)
        state = WarmStart.of(beams, theta, rays_in_box(beams, theta, box.box), coarse, box, settings)
    state = _surveyed(_searched(state, field.sliced(state.live), settings), field, settings)
    hit = torch.nonzero(torch.isfinite(state.range_m)).squeeze(1)
    index = state.rays.index
    return FirstHits(index[hit], state.range_m[hit], state.residual_m[hit], index[state.undecided]), state


def _from_grid(beams: Beams, field: ObjectField, theta: Tensor, settings: RenderSettings, grid: SdfGrid) -> WarmStart:
    """Start from a grid: correct the crossings that it shows clearly, and take its samples."""
    rays = rays_in_box(beams, theta, grid.box)
    state, readings = WarmStart.of(beams, theta, rays, grid.coarsened(), None, settings), grid.along(rays)
    rows, guess_m, slope = readings.crossings(settings.approach_slope)
    found = correct(rays.select(rows), guess_m, slope, field.sliced(state.live), settings, _GRID_REACH_M)
    of, k, g = readings.samples()
    samples = RaySamples.none().joined(RaySamples(of, k, g, torch.full_like(g, readings.error_m)))
    return replace(state.with_hits(rows, found.range_m, found.residual_m), samples=samples)


def _from_earlier(
    beams: Beams, field: ObjectField, theta: Tensor, size_m: Tensor, settings: RenderSettings, before: WarmStart
) -> WarmStart | None:
    """Start from an earlier rendering: predict its hits and samples, and correct the hits.

    Returns None if the earlier rendering says too little: it has other beams or no hit, the pose or the field has
    changed too much, or the object has left its box.
    """
    if before.age >= settings.warm_refresh or not beams.same_as(before.beams):
        return None
    box = before.box or verified_box(field, size_m, settings.box_margin_m)
    motion = (theta.detach() - before.theta).double().abs()
    if float(motion[:3].norm() + motion[3:].sum() * box.box.radius_m) > _STILL_M or box.box != before.grid.box:
        return None
    # The pose may differ: an attack that keeps a shape on the ground changes its height a little.
    rays = rays_in_box(beams, theta, box.box)
    row_of, hits = rows_of(before.rays.index, rays.index), before.linearization
    if hits is not None:
        rows = rows_of(hits.index, rays.index)
        hits, rows = hits.select(rows >= 0), rows[rows >= 0]
        (guess_m, change), was_m, slope = predict(hits, rays.select(rows), field), hits.range_m, None
        near = (guess_m - was_m).abs() < _MOTION_REACH_M
        guess_m, change = torch.where(near, guess_m, was_m), torch.where(near, change, 0.0)
    else:
        old = torch.nonzero(torch.isfinite(before.range_m) & (row_of >= 0)).squeeze(1)
        rows, guess_m, change = row_of[old], before.range_m[old], torch.zeros(len(old), dtype=torch.float64)
        slope = torch.full_like(guess_m, _FALL)
    hit = rays.select(rows)
    grid = SdfGrid.coarse(field, box.box)
    if len(rows) == 0 or float(grid.variation(before.grid).max()) > settings.warm_change_m:
        return None  # without a hit the motion of the surface is unknown
    live = union_of_units(before.live, grid.live if settings.live_units else None)
    found = correct(hit, guess_m, slope, field.sliced(live), settings, _MOTION_REACH_M)
    moved_m = float(torch.nan_to_num((change + found.g_start).abs(), nan=torch.inf).max())
    box = box.after(field, _SAFETY * moved_m)
    if not box.holds:
        return None
    state = WarmStart.of(beams, theta, rays, grid, box, settings).with_hits(rows, found.range_m, found.residual_m)
    samples = before.samples.predicted(before.rays, rays, row_of, before.grid, grid, settings.prediction_error)
    return replace(state, live=live, samples=samples, age=before.age + 1, linearization=found.linearizations)


def _searched(state: WarmStart, field: ObjectField, settings: RenderSettings) -> WarmStart:
    """Trace the rays of which nothing is known, refine every ray, solve crossings; repeat once for rays left open."""
    unknown = torch.isnan(state.range_m)
    unknown[state.samples.rows] = False
    state, left = _refined(_traced(state, unknown, field, settings), torch.ones_like(unknown), field, settings)
    if bool(left.any()):
        state, left = _refined(_traced(state, left, field, settings), left, field, settings)
    undecided = state.undecided | left
    range_m = torch.where(undecided, torch.nan, state.range_m)
    # Denser samples would tell a later rendering little more.
    samples = state.samples.before(range_m.nan_to_num(nan=torch.inf)).thinned(settings.step_m / 2)
    return replace(state, range_m=range_m, samples=samples, undecided=undecided)


def _surveyed(state: WarmStart, field: ObjectField, settings: RenderSettings) -> WarmStart:
    """Correct the hits until no hidden unit that was left out is on at a hit.

    A hit whose root the corrector does not reach is searched again on its ray, with the added units.
    """
    while state.live is not None:
        hit = torch.nonzero(torch.isfinite(state.range_m)).squeeze(1)
        rays, range_m = state.rays.select(hit), state.range_m[hit]
        live = union_of_units(state.live, field.survey(rays.at(range_m))[1]) if len(hit) else state.live
        if live is None or all(torch.equal(new, old) for new, old in zip(live, state.live, strict=True)):
            break
        sliced = field.sliced(live)
        found = correct(rays, range_m, torch.full_like(range_m, _FALL), sliced, settings, _GRID_REACH_M)
        state = replace(state.with_hits(hit, found.range_m, found.residual_m), live=live)
        lost = hit[torch.isnan(found.range_m)]
        if len(lost):
            kept = torch.ones(len(state.rays), dtype=torch.bool).index_fill(0, lost, False)
            state = _searched(replace(state, samples=state.samples.of_rays(kept)), sliced, settings)
    return state


def _traced(state: WarmStart, chosen: Tensor, field: ObjectField, settings: RenderSettings) -> WarmStart:
    """Trace the chosen rays (M,) bool from scratch."""
    rows = torch.nonzero(chosen).squeeze(1)
    if len(rows) == 0:
        return state
    samples, near_m, undecided = trace(state.rays.select(rows), field, settings)
    return replace(
        state,
        rays=replace(state.rays, near_m=state.rays.near_m.index_copy(0, rows, near_m)),
        samples=state.samples.of_rays(~chosen).joined(samples.on(rows)),
        range_m=torch.where(chosen, torch.nan, state.range_m),
        undecided=state.undecided.index_copy(0, rows, undecided),
    )


def _refined(
    state: WarmStart, chosen: Tensor, field: ObjectField, settings: RenderSettings
) -> tuple[WarmStart, Tensor]:
    """Refine the chosen rays (M,) bool and solve their crossings. Also returns (M,) bool, the rays left open."""
    chosen = chosen & ~state.undecided
    rows = torch.nonzero(chosen).squeeze(1)
    number, rays = rows_of(torch.arange(len(chosen)), rows), state.rays.select(rows)
    samples = state.samples.of_rays(chosen).on(number)
    refined = refine(samples, rays, state.range_m[rows], field, settings)
    b = refined.brackets
    roots = find_roots(
        lambda k, at: field(rays.at(k, b.rows[at])),
        *(b.outer, b.inner, b.g_outer, b.g_inner, settings.tolerance_m, settings.max_iterations),
    )
    undecided, left = state.undecided.clone(), torch.zeros_like(chosen)
    undecided[rows[refined.undecided]], undecided[rows[b.rows[~roots.converged]]] = True, True
    left[rows[refined.open]] = True
    samples = state.samples.of_rays(~chosen).joined(refined.samples.on(rows))
    state = replace(state.with_hits(rows[b.rows], roots.k, roots.residual), samples=samples, undecided=undecided)
    return state, left & ~undecided
