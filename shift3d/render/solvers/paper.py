"""The paper's renderer in plain form: sample every beam each 0.1 m, then bisect 30 times.

It is slow on purpose: the hits and the time of the fast renderer are compared with it.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render.beams import Beams, FirstHits
from shift3d.render.culling import SPHERE_RADIUS_M, Rays, beams_near, object_rays
from shift3d.render.field.object_field import ObjectField
from shift3d.render.settings import RenderSettings

FARTHEST_RETURN_M = 1000.0
"""Beyond the range of every LiDAR: a longer beam has no return (our choice)."""


def first_hits(beams: Beams, field: ObjectField, theta: Tensor, settings: RenderSettings) -> FirstHits:
    """Find the first crossing of g = 0 on every beam that passes the 7 m sphere.

    Args:
        beams: the scene's beams. theta: (6,) pose, scene frame.
        field: metric distance in the object frame.
        settings: `step_m`, `max_iterations` and `sphere_chord_only` are used.

    Unresolved beams: the sensor is inside the object, so that no crossing from outside exists, or the field is not
    finite before the crossing. A sample with g exactly 0 is outside (the paper leaves g = 0 open). A beam without a
    return, which the paper does not have, is sampled up to the far side of the sphere.
    Source: SHIFT3D supplement, Rendering.
    """
    index = beams_near(beams, theta[:3].detach(), SPHERE_RADIUS_M)
    if len(index) == 0:
        nothing = beams.ranges_m[index]
        return FirstHits(index, nothing, nothing, index)
    rays = _ending_at_sphere(object_rays(beams, index, theta))
    longest = float(rays.far_m.max()) / settings.step_m
    at_once = max(1, int(1_000_000 / max(longest, 1.0)))  # beams with about a million samples together
    found, unresolved = [], []
    for rows in torch.arange(len(rays)).split(at_once):
        part = rays.select(rows)
        samples = (part.far_m / settings.step_m).ceil().clamp_min(1.0)
        first_inside, lost = _first_sample_inside(part, samples, field, settings)
        hit = (first_inside > 0) & ~lost
        k, residual = _bisect(part.select(hit), samples[hit], first_inside[hit], field, settings)
        good = torch.isfinite(residual)
        found.append((part.index[hit][good], k[good], residual[good]))
        lost |= first_inside == 0
        lost[torch.nonzero(hit).squeeze(1)[~good]] = True
        unresolved.append(part.index[lost])
    hits = [torch.cat(column) for column in zip(*found)]
    return FirstHits(hits[0], hits[1], hits[2], torch.cat(unresolved))


def check_size(size_m: Tensor) -> None:
    """Raise InputError if the sphere cannot hold a box of size_m (3,): its outer beams would not be moved."""
    if float(size_m.norm()) / 2 > SPHERE_RADIUS_M:
        what = f"a vehicle of {' x '.join(f'{length:.1f}' for length in size_m.tolist())} m"
        remedy = "Take another accuracy, as standard or reference"
        raise InputError(f"{what} reaches out of the paper's sphere of {SPHERE_RADIUS_M:g} m", "accuracy", remedy)


def _ending_at_sphere(rays: Rays) -> Rays:
    """End rays without a return where they leave the sphere; the rest would be 100,000 useless samples."""
    along, half = _chord(rays)
    leaves = (along + half).squeeze(1)
    return replace(rays, far_m=torch.where(rays.far_m > FARTHEST_RETURN_M, leaves, rays.far_m))


def _first_sample_inside(
    rays: Rays, samples: Tensor, field: ObjectField, settings: RenderSettings
) -> tuple[Tensor, Tensor]:
    """Find, for M rays, the first j with g < 0 at k = j far / J, or -1; and the lost rays (M,) bool.

    A ray is lost if g is not finite at or before that sample; for j = -1, anywhere on the ray.
    """
    count = int(samples.max()) + 1
    j = torch.arange(count, dtype=torch.float64)
    k = j * (rays.far_m / samples)[:, None]
    wanted = j <= samples[:, None]
    if settings.sphere_chord_only:
        (along, half), margin_m = _chord(rays), float((rays.far_m / samples).max())
        wanted &= (k >= along - half - margin_m) & (k <= along + half + margin_m)
    row, column = torch.nonzero(wanted, as_tuple=True)
    negative, lost = torch.zeros(wanted.shape, dtype=torch.bool), torch.zeros(wanted.shape, dtype=torch.bool)
    for r, c in zip(row.split(settings.batch), column.split(settings.batch)):
        g = field(rays.at(k[r, c], r))
        negative[r, c], lost[r, c] = g < 0, ~torch.isfinite(g)
    first = torch.where(negative.any(1), negative.to(torch.uint8).argmax(1), -1)
    last = torch.where(first < 0, count, first)
    return first, (lost & (torch.arange(count) <= last[:, None])).any(1)


def _chord(rays: Rays) -> tuple[Tensor, Tensor]:
    """Return (M, 1) the range closest to the object's centre, and half the length of the chord of the 7 m sphere."""
    along = -(rays.origins * rays.directions).sum(-1, keepdim=True)
    offset = torch.linalg.cross(rays.origins, rays.directions).square().sum(-1, keepdim=True)
    return along, (SPHERE_RADIUS_M**2 - offset).clamp_min(0.0).sqrt()


def _bisect(
    rays: Rays, samples: Tensor, first_inside: Tensor, field: ObjectField, settings: RenderSettings
) -> tuple[Tensor, Tensor]:
    """Bisect between the first sample inside and the one before. Returns k and |g|, NaN if g was not always finite."""
    step = rays.far_m / samples
    outer, inner = (first_inside - 1) * step, first_inside * step
    lost = torch.zeros(len(rays), dtype=torch.bool)
    for _ in range(settings.max_iterations):
        middle = 0.5 * (outer + inner)
        g = field(rays.at(middle))
        lost |= ~torch.isfinite(g)
        negative = g < 0
        outer, inner = torch.where(negative, outer, middle), torch.where(negative, middle, inner)
    k = 0.5 * (outer + inner)
    return k, field(rays.at(k)).double().abs().masked_fill(lost, torch.nan)
