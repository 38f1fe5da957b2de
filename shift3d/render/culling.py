"""Culling: selects the beams that can meet the object and clips them to its bounding box."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.geometry.se3 import scene_R_object
from shift3d.render.beams import Beams

SPHERE_RADIUS_M = 7.0
"""Radius of the sphere around the object; beams outside the sphere are not moved. Source: SHIFT3D, Setup."""


@dataclass(frozen=True, eq=False)
class Box:
    """Axis-aligned box in the object frame: lower and upper corner (3,), float64, metres."""

    lower: Tensor
    upper: Tensor

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Box) and torch.equal(self.lower, other.lower) and torch.equal(self.upper, other.upper)

    def grown(self, margin_m: float) -> Box:
        """Return the box with every face moved outwards by a margin."""
        return Box(self.lower - margin_m, self.upper + margin_m)

    @property
    def radius_m(self) -> float:
        """Distance of the farthest corner from the object's centre."""
        return float(torch.maximum(self.lower.abs(), self.upper.abs()).norm())


@dataclass(frozen=True)
class Rays:
    """Segments of beams in the object frame, float64: x = origin + k direction, near_m <= k <= far_m.

    index: (M,) index of each ray's beam in the scene.
    """

    index: Tensor
    origins: Tensor
    directions: Tensor
    near_m: Tensor
    far_m: Tensor

    def __len__(self) -> int:
        return int(self.index.shape[0])

    def at(self, k: Tensor, rows: Tensor | None = None) -> Tensor:
        """Compute the object-frame points at ranges k of all rays, or of the given rows."""
        if rows is None:
            return torch.addcmul(self.origins, k[:, None], self.directions)
        return torch.addcmul(self.origins[rows], k[:, None], self.directions[rows])

    def select(self, rows: Tensor) -> Rays:
        """Select rays by row number or by mask."""
        return Rays(*take((self.index, self.origins, self.directions, self.near_m, self.far_m), rows))


def take(parts: Iterable[Tensor], rows: Tensor) -> Iterator[Tensor]:
    """Select rows of each tensor (M, ...) by number or by mask (M,); takes a third of the time of indexing."""
    numbers = torch.nonzero(rows).squeeze(1) if rows.dtype == torch.bool else rows
    return (part.index_select(0, numbers) for part in parts)


def rows_of(index: Tensor, among: Tensor) -> Tensor:
    """Return (M,) the position of each number (M,) in the ascending numbers `among` (K,); -1 if absent."""
    if len(among) == 0:
        return torch.full_like(index, -1)
    at = torch.searchsorted(among, index).clamp_max(len(among) - 1)
    return torch.where(among[at] == index, at, -1)


def beams_near(beams: Beams, centre: Tensor, radius_m: float) -> Tensor:
    """Find the beams that pass within radius_m of centre (3,) between sensor and return. Returns (M,) indices.

    Source: SHIFT3D, Setup: a beam that lies completely outside the sphere is ignored.
    """
    one_origin = len(beams) > 0 and beams.origins.stride(0) == 0
    to_centre = centre.double() - (beams.origins[0] if one_origin else beams.origins)
    along = (beams.directions * to_centre).sum(-1) if to_centre.ndim == 2 else beams.directions @ to_centre
    closest = torch.minimum(along.clamp_min(0.0), beams.ranges_m)
    square = to_centre.square().sum(-1) + closest * (closest - 2.0 * along)
    return torch.nonzero((square <= radius_m**2) & beams.carries).squeeze(1)


def object_rays(beams: Beams, index: Tensor, theta: Tensor) -> Rays:
    """Transform whole beams, sensor to return, into the frame of an object at pose theta (6,)."""
    theta = theta.detach().double()
    rotation = scene_R_object(theta)
    origins = (beams.origins[index] - theta[:3]) @ rotation
    ranges = beams.ranges_m[index]
    return Rays(index, origins, beams.directions[index] @ rotation, torch.zeros_like(ranges), ranges)


def clip_to_box(rays: Rays, lower: Tensor, upper: Tensor) -> Rays:
    """Clip rays to an axis-aligned box in the object frame; drop the rays that miss the box.

    A ray parallel to a face is inside that slab for all k or for none, without a division by zero. A ray in a face is
    inside.
    """
    parallel = rays.directions.abs() < 1e-12
    safe = torch.where(parallel, 1.0, rays.directions)
    first, second = (lower - rays.origins) / safe, (upper - rays.origins) / safe
    inside = (rays.origins >= lower) & (rays.origins <= upper)
    everywhere = torch.where(inside, torch.inf, -torch.inf).to(first)
    enter = torch.where(parallel, -everywhere, torch.minimum(first, second)).amax(-1)
    leave = torch.where(parallel, everywhere, torch.maximum(first, second)).amin(-1)
    near, far = torch.maximum(rays.near_m, enter), torch.minimum(rays.far_m, leave)
    kept = near <= far
    return Rays(rays.index, rays.origins, rays.directions, near, far).select(kept)


def rays_in_box(beams: Beams, theta: Tensor, box: Box) -> Rays:
    """Clip the beams to the object's box. Returns rays in the object frame; beams that miss the box are dropped."""
    index = beams_near(beams, theta[:3].detach(), box.radius_m)
    return clip_to_box(object_rays(beams, index, theta), box.lower, box.upper)
