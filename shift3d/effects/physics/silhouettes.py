"""Search for beams whose cone may hit something else than their axis."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from shift3d.effects.base import Insertion
from shift3d.geometry.se3 import scene_R_object
from shift3d.render.culling import Box, Rays, rays_in_box
from shift3d.render.field.bounding_box import verified_box
from shift3d.render.field.object_field import ObjectField
from shift3d.render.field.sdf_grid import vehicle_size

_LEAST_STEP_M = 0.002
_ON_FACE = 0.05
"""A sub-ray is on a face if the field is less than this share of the cone's radius (our choice). For sub-rays at a
straight edge, this misplaces the edge by as much."""
_CORRECTIONS = 3
"""Number of Newton steps from the hit on a flat face to the hit on the curved face."""
_APPROACH = 1.5
"""Factor on the stretch before an axis's hit in which the face itself counts as near; 1 would hold for a flat face."""
_BOLD = 0.9


def sub_rays(directions: Tensor, angle_rad: float) -> Tensor:
    """Compute unit vectors (C, 6, 3) at an angle around unit vectors (C, 3), every 60 degrees; float64."""
    z, x = directions.new_tensor([0.0, 0.0, 1.0]), directions.new_tensor([1.0, 0.0, 0.0])
    side = torch.linalg.cross(torch.where(directions[:, 2:].abs() < 0.9, z, x), directions)
    side = side / side.norm(dim=-1, keepdim=True)
    other = torch.linalg.cross(directions, side)
    turn = torch.arange(6, dtype=torch.float64) * (math.pi / 3.0)
    offset = turn.cos()[:, None] * side[:, None] + turn.sin()[:, None] * other[:, None]
    rays: Tensor = math.cos(angle_rad) * directions[:, None] + math.sin(angle_rad) * offset
    return rays


@torch.no_grad()
def silhouette_rows(insertion: Insertion, angle_rad: float) -> Tensor:
    """Find the rows (C,) of cast beams whose sub-rays, at an angle to the axis, may hit something else; ascending.

    A row is found if its cone comes near a surface before its axis ends, or before the face that its axis hits, or if a
    sub-ray leaves that face. Beams that do not pass the object's box cost nothing. Not differentiable.
    """
    settings, beams = insertion.settings, insertion.beams
    theta, spread = insertion.theta.detach().double(), math.tan(angle_rad)
    field = ObjectField.of(insertion.field, insertion.vehicle, settings.dtype, settings.batch, settings.bfloat16_band_m)
    box = _box(insertion, field)
    starts = beams.origins[:1] if beams.origins.stride(0) == 0 else beams.origins
    farthest = float((theta[:3] - starts).norm(dim=-1).max()) + box.radius_m
    rays = rays_in_box(beams, theta, box.grown(spread * farthest))
    chosen = torch.zeros(len(beams), dtype=torch.bool)
    until = torch.full((len(beams),), torch.inf, dtype=torch.float64)
    row = insertion.rendering.hit_mask.nonzero().squeeze(1)
    if len(row):
        chosen[row], until[row] = _off_hit_face(row, field, insertion, angle_rad)
    rays = replace(rays, far_m=torch.minimum(rays.far_m, until[rays.index]))
    rays = rays.select((rays.near_m <= rays.far_m) & ~chosen[rays.index])
    if insertion.space is not None and settings.sdf_grid and len(rays):
        clearance = insertion.space.along(rays).clearance()
        rays = rays.select(~(clearance > spread * rays.far_m))
    chosen[rays.index[_touched(rays, field, spread, settings.step_safety, settings.max_step_m)]] = True
    return chosen.nonzero().squeeze(1)


def _box(insertion: Insertion, field: ObjectField) -> Box:
    """Return the verified bounding box of the object, from the SDF grid or the rendering if possible."""
    settings, found = insertion.settings, insertion.rendering.box
    if insertion.space is not None and settings.sdf_grid:
        return insertion.space.box
    return found or verified_box(field, vehicle_size(insertion.vehicle), settings.box_margin_m).box


def _off_hit_face(row: Tensor, field: ObjectField, insertion: Insertion, angle_rad: float) -> tuple[Tensor, Tensor]:
    """Return the mask (H,) of hits with a sub-ray off the hit's face, and ranges (H,) before which it is not near.

    A sub-ray is first intersected with the plane through the hit, then corrected.
    """
    theta = insertion.theta.detach().double()
    rotation = scene_R_object(theta)
    origins = (insertion.beams.origins[row] - theta[:3]) @ rotation
    directions, range_m = insertion.beams.directions[row], insertion.rendering.range_m[row]
    axis, around = directions @ rotation, sub_rays(directions, angle_rad) @ rotation
    normal = _normals(field, origins + range_m[:, None] * axis)
    cosine, radius = -(normal * axis).sum(-1), math.tan(angle_rad) * range_m
    fall = -(around * normal[:, None]).sum(-1)
    meets = (range_m * cosine)[:, None] / torch.where(fall > 0, fall, 1.0)
    off = ~_meet_face(
        origins.repeat_interleave(6, 0),
        around.reshape(-1, 3),
        meets.reshape(-1),
        fall.reshape(-1),
        (_ON_FACE * radius).repeat_interleave(6),
        field,
    )
    near = _near(radius)[0] / insertion.settings.step_safety
    return off.reshape(-1, 6).any(-1), range_m - _APPROACH * near / cosine.clamp_min(1e-6)


def _meet_face(
    origins: Tensor, directions: Tensor, k: Tensor, fall: Tensor, tolerance_m: Tensor, field: ObjectField
) -> Tensor:
    """Return the mask (S,) of rays that meet a surface next to ranges k (S,). The field falls by `fall` (S,) a metre.

    Rays are in the object frame. A field value that is not finite counts as no surface.
    """
    met, rows, k = torch.zeros(len(k), dtype=torch.bool), torch.nonzero(fall > 0).squeeze(1), k.clone()
    for _ in range(1 + _CORRECTIONS):
        g = field(origins[rows] + k[rows, None] * directions[rows]).double()
        there = g.abs() <= tolerance_m[rows]
        met[rows[there]] = True
        k[rows] = k[rows] + g / fall[rows]
        rows = rows[~there]
    return met


def _normals(field: ObjectField, x_object: Tensor) -> Tensor:
    """Compute outward unit normals (H, 3) float64 at surface points, object frame; 0 if the gradient is 0."""
    with torch.enable_grad():
        leaf = x_object.detach().requires_grad_()
        (gradient,) = torch.autograd.grad(field(leaf).sum(), leaf)
    length = gradient.norm(dim=-1, keepdim=True)
    return gradient / torch.where(length > 0, length, 1.0)


def _touched(rays: Rays, field: ObjectField, spread: float, safety: float, max_step_m: float) -> Tensor:
    """Return the mask (M,) of rays that may have surface within spread * range on their stretch; object frame.

    Cone tracing with over-relaxed steps: `safety` times the field's distance is free on both sides of a position. The
    next position lies ahead of the known free stretch. If its own free reach does not lead back, the ray is evaluated
    again where the known stretch ends. A step is at least half the cone's radius. A cone that it may misjudge, or NaN,
    counts as touched.
    """
    found = torch.zeros(len(rays), dtype=torch.bool)
    k, ahead, rows = rays.near_m.clone(), torch.zeros(len(rays), dtype=torch.float64), torch.arange(len(rays))
    while len(rows):
        place = torch.minimum(k[rows] + ahead[rows], rays.far_m[rows])
        near, least = _near(spread * place)
        free = safety * field.estimate(rays.at(place, rows)).double()
        found[rows[~(free > near)]] = True
        reach = torch.maximum((free - spread * place) / (1.0 + spread), least).clamp_max(max_step_m)
        back = place - reach > k[rows]
        end = place + reach
        going = (free > near) & (back | (end < rays.far_m[rows]))
        k[rows] = torch.where(back, k[rows], end)
        ahead[rows] = torch.where(back, 0.0, _BOLD * reach)
        rows = rows[going]
    return found


def _near(radius: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the distance (M,) at which surface counts as touched by cones of a radius (M,), and the least step (M,).

    All in metres. Halfway through the least step, a surface is nearer by half of the step.
    """
    least = (0.5 * radius).clamp_min(_LEAST_STEP_M)
    return radius + 0.5 * least, least
