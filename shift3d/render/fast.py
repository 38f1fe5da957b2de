"""The fast renderer: cull to the vehicle's box, bracket, find roots."""

from __future__ import annotations

import torch
from torch import Tensor

from shift3d.render.beams import Beams
from shift3d.render.bounds import Box
from shift3d.render.bracket import Brackets, first_brackets
from shift3d.render.culling import Rays, beams_near, clip_to_box, object_rays
from shift3d.render.object_field import ObjectField
from shift3d.render.rendering import FirstHits
from shift3d.render.roots import find_roots
from shift3d.render.settings import RenderSettings


def rays_in_box(beams: Beams, theta: Tensor, box: Box, among: Tensor | None = None) -> Rays:
    """Beams that cross the object's box, cut to their stretch inside it.

    `among` (M,) restricts the search to some beams, which must include all that can meet the box.
    """
    index = beams_near(beams, theta[:3].detach(), box.radius_m) if among is None else among
    return clip_to_box(object_rays(beams, index, theta), box.lower, box.upper)


def first_hits(rays: Rays, field: ObjectField, settings: RenderSettings) -> tuple[FirstHits, Brackets]:
    """First crossing of g = 0 on each ray, searched afresh.

    Returns the hits and the brackets of all rays (what a warm start needs to know). Not differentiable.
    """
    brackets = first_brackets(rays, field, settings)
    rows = torch.nonzero(brackets.found).squeeze(1)
    k, residual, settled = solve(rays, rows, brackets, field, settings)
    unresolved = torch.cat((rays.index[brackets.undecided], rays.index[rows[~settled]])).sort().values
    hits = FirstHits(rays.index[rows[settled]], k[settled], residual[settled], unresolved)
    return hits, brackets


def solve(
    rays: Rays, rows: Tensor, brackets: Brackets, field: ObjectField, settings: RenderSettings
) -> tuple[Tensor, Tensor, Tensor]:
    """Roots in the brackets of some rows: ranges, residuals, and whether each is settled."""
    chosen = rays.select(rows)
    roots = find_roots(
        lambda k, r: field(chosen.at(k, r)),
        brackets.outer[rows],
        brackets.inner[rows],
        brackets.g_outer[rows],
        brackets.g_inner[rows],
        settings.tolerance_m,
        settings.max_iterations,
    )
    return roots.k, roots.residual, roots.settled
