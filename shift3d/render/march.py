"""The paper's march and bisection, inside the box alone: what culling saves without any other change.

Every beam through the checked box is sampled at fixed steps from where it enters until g < 0 or its end, and the step
that found it is bisected a fixed number of times. It misses what the paper's misses (a chord shorter than the step,
by chance) and is there to be priced: the diagram's line from the published algorithm to the default.
"""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.render.beams import Beams
from shift3d.render.bounds import checked_box
from shift3d.render.culling import Rays
from shift3d.render.fast import rays_in_box
from shift3d.render.itp import find_roots_bisection
from shift3d.render.object_field import ObjectField
from shift3d.render.rendering import FirstHits
from shift3d.render.settings import RenderSettings


def first_hits(beams: Beams, field: ObjectField, theta: Tensor, size_m: Tensor, settings: RenderSettings) -> FirstHits:
    """First crossing of g = 0 on every beam through the checked box, as far as fixed steps show it.

    Args:
        field: metric distance in the object frame.
        size_m: (3,) size of the baseline's box.
        settings: `step_m`, `max_iterations` (bisections) and `box_margin_m` are used.

    Unresolved: beams that are inside where they enter the box (the sensor is, or a shape fills it), and those whose
    field is not finite before their crossing. As the paper's, bisections end after their number whatever |g| is then.
    Not differentiable.
    Source: SHIFT3D supplement, Rendering, for march and bisection; the box is our choice.
    """
    rays = rays_in_box(beams, theta, checked_box(field, size_m, settings.box_margin_m))
    outer, g_outer = rays.near_m.clone(), field(rays.at(rays.near_m)).double()
    unresolved = g_outer < 0
    inner, g_inner, found = _march(rays, field, outer, g_outer, settings.step_m)
    rows = torch.nonzero(found).squeeze(1)
    hit = rays.select(rows)
    roots = find_roots_bisection(
        lambda k, r: field(hit.at(k, r)),
        outer[rows],
        inner[rows],
        g_outer[rows],
        g_inner[rows],
        0.0,
        settings.max_iterations,
    )
    good = torch.isfinite(roots.residual)
    unresolved |= ~torch.isfinite(g_outer)
    unresolved[rows[~good]] = True
    return FirstHits(hit.index[good], roots.k[good], roots.residual[good], rays.index[unresolved])


def _march(
    rays: Rays, field: ObjectField, outer: Tensor, g_outer: Tensor, step_m: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Step until inside: (inner, g_inner, found). `outer` and `g_outer` are moved along in place.

    A ray ends where g is not finite, and is not found.
    """
    inner, g_inner = outer.clone(), g_outer.clone()
    found = torch.zeros(len(rays), dtype=torch.bool)
    rows = torch.nonzero((g_outer >= 0) & (outer < rays.far_m)).squeeze(1)
    while len(rows):
        k = torch.minimum(outer[rows] + step_m, rays.far_m[rows])
        g = field(rays.at(k, rows)).double()
        entered, lost = g < 0, ~torch.isfinite(g)
        inner[rows], g_inner[rows], found[rows] = k, g, entered & ~lost
        on = ~entered | lost
        going = rows[on]
        outer[going], g_outer[going] = k[on], g[on]
        rows = going[(k[on] < rays.far_m[going]) & ~lost[on]]
    return inner, g_inner, found
