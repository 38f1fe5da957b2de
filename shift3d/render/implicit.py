"""Hit points as differentiable functions of latent code and pose (implicit differentiation), in one backward pass.

At a hit, g(z, T(s + k e; theta)) = 0 defines k. With the found root k* held fixed,

    k = k* - [g(z, T(s + k* e; theta)) - g*] / stop(dg/dk),    x = s + k e

has the value x* and exactly the derivatives of equations z_final and theta_final. One backward pass through x therefore
does what the paper does in three.

Grazing beams. At the silhouette dg/dk = e . grad g tends to 0 and the derivative of k grows without bound, although the
beam itself is about to leave the object. Our choice (the paper is silent): |dg/dk| is floored at `min_n_dot_d` (0.2, an
angle of 78 degrees; docs/why/accuracy.md). The gradient of a beam below the floor keeps its sign and direction and only
becomes shorter: no surface motion is amplified more than five times. Dropping grazing beams would hide the silhouette
from the attack; distributing their gradient over other beams would couple the beams. A floor of 0 is the paper's
formula; with it, a beam with dg/dk exactly 0 gets no gradient instead of NaN.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene, scene_R_object
from shift3d.render.beams import Beams, FirstHits
from shift3d.render.culling import Rays, object_rays, rows_of
from shift3d.render.field.linearization import Linearization, linearize
from shift3d.render.field.object_field import ObjectField
from shift3d.render.rendering import GrazingShare
from shift3d.render.solvers.corrector import NEWTON_SLOPE

_POLISH_M = 0.002


def surface_points(
    beams: Beams,
    hits: FirstHits,
    field: ObjectField,
    theta: Tensor,
    min_n_dot_d: float,
    polish: bool = False,
    known: Linearization | None = None,
) -> tuple[Tensor, FirstHits, GrazingShare, Linearization | None]:
    """Compute hit points as functions of pose and latent code.

    Args:
        beams: the scene's beams. hits: first crossings. theta: (6,) pose, scene frame.
        field: metric distance in the object frame; may depend on a latent code.
        min_n_dot_d: smallest |e . grad g| to divide by.
        polish: take a last Newton step if it is shorter than 2 mm; g and its slope are known here.
        known: linearization that the search has made at some of the hits.
    Returns:
        (M, 3) float64 points, scene frame, metres; the hits, polished, with the residual before the Newton step; the
            share of the gradient on grazing beams; the linearization at all hits, None if no gradient is wanted.
    Differentiable w.r.t. theta and whatever the field depends on.
    Source: SHIFT3D eqs. dl_dz to theta_final and supplement, Gradient Calculation.
    """
    origins, directions = beams.origins[hits.index], beams.directions[hits.index]
    share = GrazingShare()
    if len(hits.index) == 0 or not wants_gradient(theta, field.depends_on_code()):
        return origins + hits.range_m[:, None] * directions, hits, share, None
    pose = theta.double()
    linearization = _at_all(hits, known, field, object_rays(beams, hits.index, theta))
    change = linearization.change(field, object_from_scene(origins + hits.range_m[:, None] * directions, pose))
    slope = (linearization.gradient * (directions @ scene_R_object(pose.detach()))).sum(-1)
    if polish:
        hits = _polished(hits, linearization.g, slope)
    # At a hit a beam goes from outside to inside, so the slope is negative; a positive slope is noise about zero.
    steep = -slope.neg().clamp_min(min_n_dot_d)
    inverse = torch.where(steep < 0, 1.0 / torch.where(steep < 0, steep, 1.0), 0.0)
    range_m = hits.range_m - (change - change.detach()) * inverse
    share.beams = int((slope.abs() < min_n_dot_d).sum())
    share.least_slope = float(slope.abs().min())
    share.cosine = cosine_of(slope, linearization.gradient)
    if range_m.requires_grad:
        range_m.register_hook(_measure(share, inverse.abs(), slope.abs() < min_n_dot_d))
    return origins + range_m[:, None] * directions, hits, share, linearization


def _at_all(hits: FirstHits, known: Linearization | None, field: ObjectField, rays: Rays) -> Linearization:
    """Return the linearization at every hit: the known ones, and new ones for the other hits.

    The search may have moved a hit to another surface in front, or removed it. A known linearization therefore counts
    only if it was made at the hit's very range.
    """
    if known is None or len(known) == 0:
        return linearize(field, rays, hits.range_m)
    row = rows_of(hits.index, known.index)
    at_hit = (row >= 0) & (known.range_m[row] == hits.range_m)
    missing = torch.nonzero(~at_hit).squeeze(1)
    kept = known.select(row[at_hit])
    return kept.joined(linearize(field, rays.select(missing), hits.range_m[missing])) if len(missing) else kept


def cosine_of(slope: Tensor, gradient: Tensor) -> Tensor:
    """Compute (M,) float64 |cosine| of incidence from e . grad g and grad g (M, 3); 0 if grad g is 0."""
    length = gradient.norm(dim=-1)
    return torch.where(length > 0, slope.abs() / torch.where(length > 0, length, 1.0), 0.0).clamp_max(1.0)


def cosine_of_incidence(directions: Tensor, points: Tensor, field: ObjectField, theta: Tensor) -> Tensor:
    """Compute (M,) float64 |cosine| between beams (M, 3) and the surface normal at points (M, 3), scene frame.

    Constant: not differentiable.
    """
    rotation = scene_R_object(theta.detach().double())
    places = (points.detach().double() - theta.detach().double()[:3]) @ rotation
    still = torch.zeros(len(places), dtype=torch.float64)
    rays = Rays(torch.arange(len(places)), places, directions @ rotation, still, still)
    gradient = linearize(field, rays, still).gradient
    return cosine_of((gradient * rays.directions).sum(-1), gradient)


def wants_gradient(theta: Tensor, with_code: bool) -> bool:
    """True if the gradient of a rendering can be requested."""
    return torch.is_grad_enabled() and (with_code or theta.requires_grad)


def _polished(hits: FirstHits, g: Tensor, slope: Tensor) -> FirstHits:
    """Take one Newton step with the exact slope, but not on grazing beams, where the step may lead anywhere."""
    step = -g / slope.clamp_max(NEWTON_SLOPE)
    step = torch.where((slope <= NEWTON_SLOPE) & (step.abs() <= _POLISH_M), step, 0.0)
    return replace(hits, range_m=hits.range_m + step, residual_m=g.abs())


def _measure(share: GrazingShare, inverse: Tensor, grazing: Tensor):  # type: ignore[no-untyped-def]
    def hook(gradient: Tensor) -> None:
        weight = gradient.detach().abs() * inverse
        total = float(weight.sum())
        share.gradient = float(weight[grazing].sum()) / total if total > 0 else 0.0

    return hook
