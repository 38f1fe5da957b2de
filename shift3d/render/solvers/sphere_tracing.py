"""Sphere tracing (Hart 1996): along a ray no crossing is nearer than the field's own distance.

`first_hits` is the plain form, the solver `plain_sphere_tracing`: a step is a share of g, at least `step_m`, until
g < 0; then a root is solved in the last step. `trace` is the default solver's first pass over rays of which nothing is
known. Its steps are as long as the spheres at both their ends probably reach; `refinement.refine` closes the rest.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from shift3d.render.beams import Beams, FirstHits
from shift3d.render.culling import Rays, rays_in_box
from shift3d.render.field.bounding_box import verified_box
from shift3d.render.field.object_field import ObjectField
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.ray_samples import RaySamples
from shift3d.render.solvers.roots import find_roots

_BACK_STEP_M = 0.1
_BOLDNESS = 0.95
_STEEPEST = 10.0
# A decoder takes as long for one point as for thirty: `refine` samples the last few rays in parallel.
_FEW = 32


def first_hits(beams: Beams, field: ObjectField, theta: Tensor, size_m: Tensor, settings: RenderSettings) -> FirstHits:
    """Find first crossings by plain sphere tracing: the simple reference of the default solver.

    Args:
        field: metric distance in the object frame. size_m: (3,) size of the baseline's box.
        settings: `step_m`, `step_safety`, `tolerance_m`, `max_iterations` and `box_margin_m` are used.
    Not differentiable. Source: Hart 1996; the least step is the paper's sampling.
    """
    rays = rays_in_box(beams, theta, verified_box(field, size_m, settings.box_margin_m).box)
    rays, g, undecided = outside(rays, field)
    k, k_outer, g_outer = rays.near_m.clone(), rays.near_m.clone(), g.clone()
    rows = torch.nonzero(~undecided).squeeze(1)
    while len(rows):
        k_outer[rows], g_outer[rows] = k[rows], g[rows]
        step = (settings.step_safety * g[rows]).clamp_min(settings.step_m)
        k[rows] = torch.minimum(k[rows] + step, rays.far_m[rows])
        g[rows] = field(rays.at(k[rows], rows)).double()
        undecided[rows] = ~torch.isfinite(g[rows])
        rows = rows[(g[rows] >= 0) & (k[rows] < rays.far_m[rows])]
    hit = torch.nonzero((g < 0) & ~undecided).squeeze(1)
    roots = find_roots(
        lambda along, at: field(rays.at(along, hit[at])),
        k_outer[hit],
        k[hit],
        g_outer[hit],
        g[hit],
        settings.tolerance_m,
        settings.max_iterations,
    )
    undecided[hit[~roots.converged]] = True
    good = roots.converged
    return FirstHits(rays.index[hit[good]], roots.k[good], roots.residual[good], rays.index[undecided])


def outside(rays: Rays, field: ObjectField) -> tuple[Rays, Tensor, Tensor]:
    """Extend rays that start inside the object back towards their sensor until they start outside.

    Returns the rays, g (M,) at their starts, and (M,) bool, rays without a start outside: a sensor inside the object.
    """
    k = rays.near_m.clone()
    g = field.estimate(rays.at(k)).double()
    rows = torch.nonzero((g < 0) & (k > 0)).squeeze(1)
    while len(rows):
        k[rows] = (k[rows] - _BACK_STEP_M).clamp_min(0.0)
        g[rows] = field.estimate(rays.at(k[rows], rows)).double()
        rows = rows[(g[rows] < 0) & (k[rows] > 0)]
    return replace(rays, near_m=k), g, ~(torch.isfinite(g) & (g >= 0))


def trace(rays: Rays, field: ObjectField, settings: RenderSettings) -> tuple[RaySamples, Tensor, Tensor]:
    """Sample rays of which nothing is known. The intervals between the samples are not proven free.

    Returns samples of each ray up to its first place inside, (M,) the starts of the rays, and (M,) bool, undecided.

    A beam along a panel keeps its distance from the panel, and the sphere at the far end of a step covers as much of
    the step as the sphere at its near end: if g continues at its slope, twice the length is free. Source: Keinert et
    al. 2014, over-relaxation.
    """
    rays, g, undecided = outside(rays, field)
    k, slope = rays.near_m.clone(), torch.full_like(g, -1.0)
    parts = [(torch.arange(len(rays)), k.clone(), g.clone())]
    rows, longest = torch.nonzero(~undecided & (k < rays.far_m)).squeeze(1), max(settings.step_m, settings.max_step_m)
    while len(rows) > _FEW:
        here, steep = g[rows], (-slope[rows]).clamp(1.0, _STEEPEST)
        free = settings.step_safety * here / steep
        bold = _BOLDNESS * (2.0 * free + settings.step_m) / (1.0 - slope[rows].clamp(-1.0, 0.5))
        step = torch.maximum(free + settings.step_m, bold).clamp_max(longest)
        k_new = torch.minimum(k[rows] + step, rays.far_m[rows])
        g_new = field.estimate(rays.at(k_new, rows), here + slope[rows] * (k_new - k[rows])).double()
        slope[rows] = (g_new - here) / (k_new - k[rows]).clamp_min(1e-12)
        k[rows], g[rows] = k_new, g_new
        parts.append((rows, k_new, g_new))
        undecided[rows] = ~torch.isfinite(g_new)
        rows = rows[(g_new >= 0) & (k_new < rays.far_m[rows]) & ~undecided[rows]]
    rows, k, g = (torch.cat(part) for part in zip(*parts, strict=True))
    samples = RaySamples(rows, k, g, torch.zeros_like(g))
    return RaySamples.none().joined(samples.select(~undecided[rows])), rays.near_m, undecided
