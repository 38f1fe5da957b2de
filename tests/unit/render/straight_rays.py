"""Rays along x through closed-form fields, and samples of them every millimetre."""

from __future__ import annotations

import math

import torch
from analytic_fields import Field, Frame
from torch import Tensor

from shift3d.render.culling import Box, Rays
from shift3d.render.field.object_field import ObjectField
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.settings import STANDARD, RenderSettings
from shift3d.render.solvers.ray_samples import RaySamples
from shift3d.render.solvers.refinement import Refinement, refine
from shift3d.render.solvers.sphere_tracing import trace

FLOAT64 = STANDARD.with_(dtype=torch.float64)
_SPACING_M = 1e-3


def along_x(*offsets: float, start: float = -3.0, length: float = 6.0) -> Rays:
    """Return rays in +x from x = start, at these y."""
    origins = torch.tensor([[start, y, 0.0] for y in offsets], dtype=torch.float64)
    one = torch.ones(len(offsets), dtype=torch.float64)
    directions = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(len(offsets), 3)
    return Rays(torch.arange(len(offsets)), origins, directions, 0 * one, length * one)


def field_of(metric: Field) -> ObjectField:
    return ObjectField.of(metric, Frame(), torch.float64, 4096)


def coarse(metric: Field, box: Box) -> SdfGrid:
    """Return the coarse grid of a field over a box."""
    return SdfGrid.coarse(field_of(metric), box)


def samples_at(rays: Rays, metric: Field, ranges: list[float] | Tensor) -> RaySamples:
    """Return measured samples of every ray at these ranges."""
    k = torch.as_tensor(ranges, dtype=torch.float64)
    rows = torch.arange(len(rays)).repeat_interleave(len(k))
    k = k.repeat(len(rays))
    g = metric(rays.at(k, rows))
    return RaySamples(rows, k, g, torch.zeros_like(g))


def cold(rays: Rays, metric: Field, settings: RenderSettings = FLOAT64) -> Refinement:
    """Refine rays without any samples."""
    field = field_of(metric)
    samples, near_m, undecided = trace(rays, field, settings)
    started = Rays(rays.index, rays.origins, rays.directions, near_m, rays.far_m)
    nowhere = torch.full_like(rays.far_m, math.nan)
    found = refine(samples, started, nowhere, field, settings)
    return Refinement(found.samples, found.brackets, found.undecided | undecided, found.open)


def is_found(found: Refinement) -> Tensor:
    """Return (M,) bool: rays with a crossing."""
    mask = torch.zeros_like(found.open)
    mask[found.brackets.rows] = True
    return mask


def crossings(found: Refinement, metric: Field, rays: Rays) -> Tensor:
    """Return (M,) ranges at which brackets enter, to a millimetre; infinite without a bracket."""
    b, entry = found.brackets, torch.full_like(rays.far_m, torch.inf)
    assert len(set(b.rows.tolist())) == len(b.rows), "one crossing a ray"
    for at, row in enumerate(b.rows.tolist()):
        assert float(b.g_outer[at]) >= 0 > float(b.g_inner[at]) and float(b.outer[at]) < float(b.inner[at])
        k = torch.arange(float(b.outer[at]), float(b.inner[at]) + _SPACING_M, _SPACING_M, dtype=torch.float64)
        inside = metric(rays.at(k, torch.full((len(k),), row))) < 0
        entry[row] = k[inside.byte().argmax()] if inside.any() else b.inner[at]
    return entry


def chords(metric: Field, rays: Rays) -> list[list[tuple[float, float]]]:
    """Return the intervals of every ray inside the object, first to last, by samples every millimetre."""
    found = []
    for row in range(len(rays)):
        k = torch.arange(float(rays.near_m[row]), float(rays.far_m[row]), _SPACING_M, dtype=torch.float64)
        inside = (metric(rays.at(k, torch.full((len(k),), row))) < 0).long()
        edges = torch.nn.functional.pad(inside, (1, 1)).diff()
        ends = torch.cat((k, rays.far_m[row : row + 1]))
        starts, stops = (ends[torch.nonzero(edges == sign).squeeze(1)].tolist() for sign in (1, -1))
        found.append(list(zip(starts, stops, strict=True)))
    return found


def check_against_dense(
    entry: Tensor, metric: Field, rays: Rays, least_m: float = 0.05, skipped: Tensor | None = None
) -> None:
    """Check that every chord of at least `least_m` is found, and no entry in front of the first chord.

    skipped: (M,) bool, rays without this check.
    """
    for row, stretches in enumerate(chords(metric, rays)):
        if skipped is not None and bool(skipped[row]):
            continue
        long = [start for start, stop in stretches if stop - start >= least_m]
        if long:
            assert float(entry[row]) <= long[0] + 2e-3, (row, stretches)
        first = stretches[0][0] if stretches else math.inf
        # A chord shorter than the spacing of the dense samples shows only in the field itself.
        if float(entry[row]) < first - 2e-3:
            k = entry[row] + torch.linspace(-1e-3, 1e-3, 401, dtype=torch.float64)
            assert float(metric(rays.at(k, torch.full((401,), row))).min()) < 0, (row, stretches)
