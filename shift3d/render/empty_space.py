"""A map of a shape's distances, made once for a code that is rendered many times.

Poses, placements and baselines render one latent code again and again. A lattice of its field, coarse in the whole box
and finer around the surface, then says without another evaluation where along a ray surface can be, and where it
surely is. The map's own error is measured when it is made, at places between its points, and taken half as large
again: a sample above it is free space, one below its negative is inside, and the decoder decides what lies between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from shift3d.render.bounds import Box, checked_box
from shift3d.render.culling import Rays
from shift3d.render.object_field import Field, ObjectField, VehicleFrame
from shift3d.render.settings import STANDARD, RenderSettings

SAMPLE_M = 0.02
"""Spacing of the map's samples along a ray."""
_FINE_BAND_M = (-0.09, 0.12)
_CHECKS = 4000
_MARGIN = 1.5
_LEAST_ERROR_M = 0.005
_CLEAN_M = 0.4
_PLAIN_SLOPE = 0.3
_THINNED = 8


@dataclass(frozen=True)
class EmptySpace:
    """Distances on a lattice over the shape's box.

    box: checked box, object frame. distance_m: (nx, ny, nz) float32 at its lattice, corners included. error_m: what
    a value in between may be off by near the surface, measured, with a margin. evaluations: what the map cost.
    """

    box: Box
    distance_m: Tensor
    error_m: float
    evaluations: int

    @staticmethod
    def of(
        sdf: Field, vehicle: VehicleFrame, settings: RenderSettings = STANDARD, spacing_m: float = 0.05
    ) -> EmptySpace:
        """Map the field of one code. About 90,000 evaluations for a car at 0.05 m.

        spacing_m: of the lattice near the surface; twice as much elsewhere. Source: our choice: the paper is silent.
        """
        metric = ObjectField.of(sdf, vehicle, settings.dtype, settings.batch, settings.coarse_band_m)
        with torch.no_grad():
            box = checked_box(
                metric, torch.as_tensor(np.asarray(vehicle.size_m, dtype=np.float64)), settings.box_margin_m
            )
            cells = ((box.upper - box.lower) / (2 * spacing_m)).ceil().clamp_min(1).long()
            coarse = metric.estimate(_lattice(box, cells)).float().reshape((cells + 1).tolist())
            fine = functional.interpolate(
                coarse[None, None], (2 * cells + 1).tolist(), mode="trilinear", align_corners=True
            )[0, 0]
            flat = fine.reshape(-1)
            band = torch.nonzero((flat > _FINE_BAND_M[0]) & (flat < _FINE_BAND_M[1])).squeeze(1)
            flat[band] = metric(_lattice(box, 2 * cells)[band]).float()
            unchecked = EmptySpace(box, flat.reshape(fine.shape), 0.0, 0)
            error_m = max(_MARGIN * unchecked.worst_error(metric), _LEAST_ERROR_M)
        return EmptySpace(box, unchecked.distance_m, error_m, metric.count.evaluations)

    def worst_error(self, field: ObjectField) -> float:
        """Largest difference from the field at places drawn near the surface, metres; infinite where one is NaN."""
        place = torch.rand(8 * _CHECKS, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        x = self.box.lower + place * (self.box.upper - self.box.lower)
        guess = self.at(x)
        near = torch.nonzero((guess > _FINE_BAND_M[0] / 2) & (guess < _FINE_BAND_M[1] / 2)).squeeze(1)[:_CHECKS]
        if len(near) == 0:
            return 0.0
        off = (field(x[near]).float() - guess[near]).abs()
        return float(torch.nan_to_num(off, nan=torch.inf).max())

    def at(self, x_object: Tensor) -> Tensor:
        """(..., ) float32 distances at object-frame points (..., 3) inside the box; trilinear."""
        place = (x_object - self.box.lower) / (self.box.upper - self.box.lower) * 2.0 - 1.0
        return self._read(place.flip(-1).float())

    def _read(self, grid: Tensor) -> Tensor:
        """(..., ) distances at places (..., 3) float32, -1 to 1 over the box, the last axis of the lattice first."""
        values = functional.grid_sample(
            self.distance_m[None, None],
            grid.reshape(1, 1, 1, -1, 3),
            mode="bilinear",
            padding_mode="border",
            align_corners=True,
        )
        return values.reshape(grid.shape[:-1])

    def sight(self, rays: Rays) -> Sight:
        """What the map knows along rays that are cut to its box."""
        longest = float((rays.far_m - rays.near_m).max()) if len(rays) else 0.0
        count = max(2, math.ceil(longest / SAMPLE_M) + 2)
        along = torch.arange(count, dtype=torch.float64) * SAMPLE_M
        beyond = along > (rays.far_m - rays.near_m)[:, None] + SAMPLE_M
        # Hundreds of samples a ray: straight in the map's own coordinates, where float32 is good to a micrometre.
        scale = 2.0 / (self.box.upper - self.box.lower)
        start = (rays.origins + rays.near_m[:, None] * rays.directions - self.box.lower) * scale - 1.0
        start, step = (part.flip(-1).float()[:, None, :] for part in (start, rays.directions * scale))
        distance = self._read(start + along.float()[:, None] * step).masked_fill_(beyond, torch.inf)
        return Sight(rays.near_m, distance, self.error_m + 0.5 * SAMPLE_M)


@dataclass(frozen=True)
class Sight:
    """The map's distances (M, S) along M rays, every `SAMPLE_M` from near_m (M,); infinite past a ray's end.

    doubt_m: below this a sample may be next to surface, below its negative it surely is inside. A NaN is in doubt.
    """

    near_m: Tensor
    distance_m: Tensor
    doubt_m: float

    def leaps(self) -> Leaps:
        """The stretches that may hold surface, for a march."""
        count = self.distance_m.shape[1]
        position = torch.where(self.distance_m >= self.doubt_m, count, torch.arange(count))
        return Leaps(self.near_m, position.flip(1).cummin(1).values.flip(1).int(), count)

    def crossings(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rays (m,) that plainly enter the object, where (m,) they cross, and the slope (m,) there.

        Plainly: from the first doubtful sample to the first that is surely inside the distance falls all the way, at
        no flat angle, over at most 0.4 m. Anything else is for a march to decide: a part thinner than the lattice
        shows as a place where the fall slackens.
        """
        doubtful, inside = ~(self.distance_m >= self.doubt_m), self.distance_m < -self.doubt_m
        first, entered = doubtful.byte().argmax(1), inside.byte().argmax(1)
        slack = ~(self.distance_m.diff(dim=1) <= -_PLAIN_SLOPE * SAMPLE_M)
        slack = torch.nn.functional.pad(slack.int().cumsum(1), (1, 0))
        rows = torch.nonzero(inside.any(1)).squeeze(1)
        a, b = first[rows], entered[rows]
        falls = slack[rows, b] == slack[rows, a]
        kept = falls & ((b - a) * SAMPLE_M <= _CLEAN_M) & ((a > 0) | (self.distance_m[rows, 0] > 0))
        rows, a, b = rows[kept], a[kept], b[kept]
        after = ((self.distance_m[rows] < 0) & (torch.arange(self.distance_m.shape[1]) >= a[:, None])).byte().argmax(1)
        after = after.clamp_min(1)
        g1, g0 = self.distance_m[rows, after].double(), self.distance_m[rows, after - 1].double()
        slope = (g1 - g0) / SAMPLE_M
        share = torch.where(g0 > g1, g0 / (g0 - g1).clamp_min(1e-9), 0.5)
        guess = self.near_m[rows] + (after - 1 + share) * SAMPLE_M
        return rows, guess, slope

    def samples(self) -> tuple[Tensor, Tensor, Tensor]:
        """Of every `_THINNED` samples the one nearest to the surface, where the map vouches for it: rays, ranges, g."""
        rays, count = self.distance_m.shape
        spare = -count % _THINNED
        padded = functional.pad(self.distance_m, (0, spare), value=math.inf)
        least, at = padded.reshape(rays, (count + spare) // _THINNED, _THINNED).min(-1)
        rows, window = torch.nonzero((least >= self.doubt_m) & torch.isfinite(least), as_tuple=True)
        k = self.near_m[rows] + (window * _THINNED + at[rows, window]) * SAMPLE_M
        return rows, k, least[rows, window].double()

    def closest(self) -> tuple[Tensor, Tensor]:
        """(M,) least distance along each ray, as far as the map can vouch for it, and where that is."""
        least, at = self.distance_m.min(1)
        return (least.double() - self.doubt_m).clamp_min(0.0), self.near_m + at * SAMPLE_M


@dataclass(frozen=True)
class Leaps:
    """Per ray and sample, the next sample that may be next to surface (`count` if there is none)."""

    near_m: Tensor
    upcoming: Tensor
    count: int

    def leap(self, k: Tensor, rows: Tensor) -> Tensor:
        """(m,) first range >= k at which surface may lie, infinite if there is none. One sample is kept in hand."""
        sample = ((k - self.near_m[rows]) / SAMPLE_M).floor().long().clamp(0, self.count - 1)
        ahead = self.upcoming[rows, sample]
        start = self.near_m[rows] + (ahead - 1) * SAMPLE_M
        return torch.where(ahead >= self.count, torch.inf, torch.maximum(k, start))

    def first(self) -> Tensor:
        """(M,) where each ray first may meet surface, infinite if nowhere."""
        rows = torch.arange(len(self.near_m))
        return self.leap(self.near_m, rows)

    def select(self, rows: Tensor) -> Leaps:
        """Some of the rays."""
        return Leaps(self.near_m[rows], self.upcoming[rows], self.count)


def _lattice(box: Box, cells: Tensor) -> Tensor:
    """(prod(cells + 1), 3) float64 lattice points of a box, object frame."""
    axes = [
        torch.linspace(float(low), float(high), int(n) + 1, dtype=torch.float64)
        for low, high, n in zip(box.lower, box.upper, cells)
    ]
    return torch.cartesian_prod(*axes)
