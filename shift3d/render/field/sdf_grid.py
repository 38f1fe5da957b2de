"""SDF grids: trilinear lookup tables of a field over the vehicle's box.

Poses, placements and baselines render one latent code many times. `SdfGrid.of` its field, fine near the surface and
coarser elsewhere, predicts samples and surface crossings along rays without evaluations. The error bound of a
prediction is 1.5 times the largest error measured between nodes when the grid is made, at least 5 mm.

`SdfGrid.coarse` has nodes 0.45 m apart. Two coarse grids give the change of the field between two codes.

Source: our choice: the paper evaluates the field everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from shift3d.render.culling import Box, Rays
from shift3d.render.field.bounding_box import verified_box
from shift3d.render.field.object_field import Field, LiveUnits, ObjectField, VehicleFrame
from shift3d.render.settings import STANDARD, RenderSettings

NODE_SPACING_M = 0.05
"""Node spacing of an SDF grid near the surface; twice as much elsewhere."""
READING_SPACING_M = 0.02
"""Spacing of the readings along a ray."""
COARSE_SPACING_M = 0.45
"""Largest node spacing of a coarse grid."""
_FINE_BAND_M = (-0.09, 0.12)
_CHECKS = 4000
_MARGIN = 1.5
_LEAST_ERROR_M = 0.005
_DENSE_M = 0.03
_LEAST_FREE_M = 0.004


@dataclass(frozen=True)
class SdfGrid:
    """Field values at grid nodes over a shape's box.

    box: verified box, object frame. distance_m: (nx, ny, nz) float32 at the nodes, corners included. error_m: error
    bound of a reading near the surface; infinite for a coarse grid. evaluations: number of evaluations that the grid
    took. live: hidden units that are on at the nodes.
    """

    box: Box
    distance_m: Tensor
    error_m: float = math.inf
    evaluations: int = 0
    live: LiveUnits = None

    @staticmethod
    def of(sdf: Field, vehicle: VehicleFrame, settings: RenderSettings = STANDARD) -> SdfGrid:
        """Compute the grid of one latent code's field. Takes about 90,000 evaluations for a car."""
        metric = ObjectField.of(sdf, vehicle, settings.dtype, settings.batch, settings.bfloat16_band_m)
        with torch.no_grad():
            box = verified_box(metric, vehicle_size(vehicle), settings.box_margin_m).box
            cells = ((box.upper - box.lower) / (2 * NODE_SPACING_M)).ceil().clamp_min(1).long()
            coarse = metric.estimate(_nodes(box, cells)).float().reshape((cells + 1).tolist())
            size = (2 * cells + 1).tolist()
            fine = functional.interpolate(coarse[None, None], size, mode="trilinear", align_corners=True)[0, 0]
            flat = fine.reshape(-1)
            band = torch.nonzero((flat > _FINE_BAND_M[0]) & (flat < _FINE_BAND_M[1])).squeeze(1)
            near = _nodes(box, 2 * cells)[band]
            flat[band] = metric(near).float()
            _, live = metric.survey(torch.cat((_nodes(box, cells), near[::4])))
            unchecked = SdfGrid(box, flat.reshape(fine.shape))
            error_m = max(_MARGIN * unchecked.worst_error(metric), _LEAST_ERROR_M)
        return SdfGrid(box, unchecked.distance_m, error_m, metric.count.evaluations, live)

    @staticmethod
    def coarse(field: ObjectField, box: Box) -> SdfGrid:
        """Compute a field's coarse grid; `live`: units that are on at its nodes."""
        nodes, shape = _coarse_nodes(box)
        g, live = field.survey(nodes)
        return SdfGrid(box, g.float().reshape(shape), live=live)

    def coarsened(self) -> SdfGrid:
        """Resample this grid at the nodes of a coarse grid, without evaluations."""
        nodes, shape = _coarse_nodes(self.box)
        return SdfGrid(self.box, self.at(nodes).reshape(shape), live=self.live)

    def variation(self, before: SdfGrid) -> Tensor:
        """Compute, per cell, the largest minus the smallest change since grid `before` (same box), metres."""
        change = (self.distance_m - before.distance_m)[None, None]
        return (functional.max_pool3d(change, 2, 1) + functional.max_pool3d(-change, 2, 1))[0, 0]

    def of_cells(self, x: Tensor, values: Tensor) -> Tensor:
        """Return (N,) float64 the per-cell values of the cells that contain the points (N, 3), object frame."""
        cells = torch.tensor(values.shape)
        cell = ((x - self.box.lower) / (self.box.upper - self.box.lower) * cells).floor().long()
        return values[tuple(torch.minimum(cell.clamp_min(0), cells - 1).unbind(-1))].double()

    def worst_error(self, field: ObjectField) -> float:
        """Measure the largest error at random points near the surface, metres; infinite if an error is NaN."""
        place = torch.rand(8 * _CHECKS, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        x = self.box.lower + place * (self.box.upper - self.box.lower)
        guess = self.at(x)
        near = torch.nonzero((guess > _FINE_BAND_M[0] / 2) & (guess < _FINE_BAND_M[1] / 2)).squeeze(1)[:_CHECKS]
        if len(near) == 0:
            return 0.0
        off = (field(x[near]).float() - guess[near]).abs()
        return float(torch.nan_to_num(off, nan=torch.inf).max())

    def at(self, x_object: Tensor) -> Tensor:
        """Interpolate (..., ) float32 distances at points (..., 3), object frame, trilinear, clamped to the box."""
        place = (x_object - self.box.lower) / (self.box.upper - self.box.lower) * 2.0 - 1.0
        return _read(self.distance_m, place.flip(-1).float())

    def along(self, rays: Rays) -> GridReadings:
        """Read the grid along rays that are clipped to its box."""
        longest = float((rays.far_m - rays.near_m).max()) if len(rays) else 0.0
        count = max(2, math.ceil(longest / READING_SPACING_M) + 2)
        along = torch.arange(count, dtype=torch.float64) * READING_SPACING_M
        beyond = along > (rays.far_m - rays.near_m)[:, None] + READING_SPACING_M
        # Hundreds of readings per ray: computed in grid coordinates, in which float32 is exact to a micrometre.
        scale = 2.0 / (self.box.upper - self.box.lower)
        start = (rays.origins + rays.near_m[:, None] * rays.directions - self.box.lower) * scale - 1.0
        start, step = (part.flip(-1).float()[:, None, :] for part in (start, rays.directions * scale))
        distance = _read(self.distance_m, start + along.float()[:, None] * step).masked_fill_(beyond, torch.inf)
        return GridReadings(rays.near_m, distance, self.error_m)


@dataclass(frozen=True)
class GridReadings:
    """Distances (M, S) along M rays, every `READING_SPACING_M` from near_m (M,); infinite beyond the end of a ray.

    error_m: error bound. A reading below it may be at the surface, one below -error_m is surely inside; NaN may be
    either.
    """

    near_m: Tensor
    distance_m: Tensor
    error_m: float

    def crossings(self, slope: float) -> tuple[Tensor, Tensor, Tensor]:
        """Find rays that clearly enter the object. Returns their rows (m,), ranges of crossings (m,) and dg/dk (m,).

        Clearly: g falls by `slope` or more at the first reading below zero, and some reading is surely inside. Another
        crossing may hide in front of the returned one; `refinement.refine` decides that.
        """
        rows = torch.nonzero((self.distance_m < -self.error_m).any(1)).squeeze(1)
        after = (self.distance_m[rows] < 0).byte().argmax(1)
        kept = (after > 0) & (
            self.distance_m[rows, after] - self.distance_m[rows, after - 1] <= -slope * READING_SPACING_M
        )
        rows, after = rows[kept], after[kept]
        g1, g0 = self.distance_m[rows, after].double(), self.distance_m[rows, after - 1].double()
        return rows, self.near_m[rows] + (after - 1 + g0 / (g0 - g1)) * READING_SPACING_M, (g1 - g0) / READING_SPACING_M

    def samples(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return samples that are surely outside, and each ray's first one surely inside: rays, ranges, g.

        Samples are sparser far from the surface; the spheres around them still cover all that the grid proves to be
        free.
        """
        g, number = self.distance_m, torch.arange(self.distance_m.shape[1])
        free = g - self.error_m
        kept = free < _DENSE_M
        for every in (2, 4, 8):
            kept |= (free < every * _DENSE_M) & (number % every == 0)
        kept |= number % 16 == 0
        rows, at = torch.nonzero(kept & (free > _LEAST_FREE_M) & torch.isfinite(g), as_tuple=True)
        inside = g < -self.error_m
        entered = torch.nonzero(inside.any(1)).squeeze(1)
        first = inside[entered].byte().argmax(1)
        rows, at = torch.cat((rows, entered)), torch.cat((at, first))
        return rows, self.near_m[rows] + at * READING_SPACING_M, g[rows, at].double()

    def clearance(self) -> Tensor:
        """Return (M,) least distance along each ray, less the error bound and what may lie between two readings."""
        return (self.distance_m.min(1).values.double() - self.error_m - 0.5 * READING_SPACING_M).clamp_min(0.0)


def vehicle_size(vehicle: VehicleFrame) -> Tensor:
    """Return (3,) float64 size of the baseline's box, metres."""
    return torch.as_tensor([float(side) for side in vehicle.size_m], dtype=torch.float64)


def _read(grid: Tensor, place: Tensor) -> Tensor:
    """Interpolate trilinearly at positions (..., 3) float32: -1 to 1 over the grid, the grid's last axis first."""
    values = functional.grid_sample(
        grid[None, None], place.reshape(1, 1, 1, -1, 3), padding_mode="border", align_corners=True
    )
    return values.reshape(place.shape[:-1])


def _coarse_nodes(box: Box) -> tuple[Tensor, list[int]]:
    cells = ((box.upper - box.lower) / COARSE_SPACING_M).ceil().clamp_min(1).long()
    return _nodes(box, cells), (cells + 1).tolist()


def _nodes(box: Box, cells: Tensor) -> Tensor:
    """Return the (prod(cells + 1), 3) float64 nodes of a box, object frame."""
    axes = [
        torch.linspace(float(low), float(high), int(n) + 1, dtype=torch.float64)
        for low, high, n in zip(box.lower, box.upper, cells)
    ]
    return torch.cartesian_prod(*axes)
