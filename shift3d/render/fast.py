"""The pieces of the fast renderer put together: cull to a box, bracket, find roots."""

from __future__ import annotations

from torch import Tensor

from shift3d.render.beams import Beams
from shift3d.render.bounds import Box
from shift3d.render.bracket import Brackets
from shift3d.render.culling import Rays, beams_near, clip_to_box, object_rays
from shift3d.render.itp import find_roots_bisection, find_roots_itp
from shift3d.render.object_field import ObjectField
from shift3d.render.roots import Roots, find_roots
from shift3d.render.settings import RenderSettings

_ROOTS = {"anderson_bjorck": find_roots, "itp": find_roots_itp, "bisection": find_roots_bisection}


def rays_in_box(beams: Beams, theta: Tensor, box: Box) -> Rays:
    """Beams that cross the object's box, cut to their stretch inside it."""
    index = beams_near(beams, theta[:3].detach(), box.radius_m)
    return clip_to_box(object_rays(beams, index, theta), box.lower, box.upper)


def solve(rays: Rays, rows: Tensor, brackets: Brackets, field: ObjectField, settings: RenderSettings) -> Roots:
    """Roots in the brackets of some rows. Not differentiable."""
    chosen = rays.select(rows)
    return _ROOTS[settings.root](
        lambda k, r: field(chosen.at(k, r)),
        brackets.outer[rows],
        brackets.inner[rows],
        brackets.g_outer[rows],
        brackets.g_inner[rows],
        settings.tolerance_m,
        settings.max_iterations,
    )
