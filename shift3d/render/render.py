"""Insert an object into a scene: the one entry point of this package."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render import exact, march, reference
from shift3d.render.beams import Beams
from shift3d.render.empty_space import EmptySpace
from shift3d.render.implicit import surface_points, wants_gradient
from shift3d.render.object_field import Field, ObjectField, VehicleFrame
from shift3d.render.rendering import FirstHits, Rendering
from shift3d.render.settings import STANDARD, RenderSettings
from shift3d.render.warm import WarmStart, cold_start, warm_start


def render(
    beams: Beams,
    field: Field,
    theta: Tensor,
    vehicle: VehicleFrame,
    settings: RenderSettings = STANDARD,
    warm: WarmStart | None = None,
    space: EmptySpace | None = None,
) -> Rendering:
    """Move every return whose beam meets the object to the first crossing of its surface.

    Args:
        beams: the scene's beams, scene frame.
        field: signed distance in the vehicle's sdf frame, negative inside, in `settings.dtype`.
        theta: (6,) x, y, z, yaw, pitch, roll of the object in the scene frame; metres, radians.
        vehicle: scale and axes of the sdf frame, size of the baseline.
        settings: every approximation.
        warm: `Rendering.warm` of an earlier rendering of the same beams and vehicle, nearby in code or pose.
        space: `EmptySpace.of` this very field, where it is rendered often. Used by the fast solver alone.

    Returns:
        Rendering. Its points are differentiable w.r.t. theta and the field's latent code.

    Raises:
        InputError: a pose that is not six finite numbers; a tolerance that the dtype cannot reach on this vehicle.

    Source: SHIFT3D, Object Rendering in LiDAR scene.
    """
    if theta.shape != (6,) or not bool(torch.isfinite(theta).all()):
        raise InputError("a pose is six finite numbers: x, y, z, yaw, pitch, roll", where=f"pose {theta.tolist()}")
    settings.check_tolerance(float(vehicle.scale_m))
    metric = ObjectField.of(field, vehicle, settings.dtype, settings.batch, settings.coarse_band_m)
    state = None
    if settings.unchecked_m and not wants_gradient(theta, metric.depends_on_code()):
        settings = settings.with_(unchecked_m=0.0)
    with torch.no_grad():
        if settings.solver == "paper":
            hits = reference.first_hits(beams, metric, theta, settings)
        else:
            hits, state = _fast(beams, metric, theta, vehicle, settings, warm, space)
    return assemble(beams, hits, metric, theta, settings, state)


def _fast(
    beams: Beams,
    metric: ObjectField,
    theta: Tensor,
    vehicle: VehicleFrame,
    settings: RenderSettings,
    warm: WarmStart | None,
    space: EmptySpace | None,
) -> tuple[FirstHits, WarmStart | None]:
    space = space if settings.empty_space else None
    size = torch.as_tensor(np.asarray(vehicle.size_m, dtype=np.float64))
    if settings.solver == "exact" and metric.piecewise_linear():
        return exact.first_hits(beams, metric, theta, size, settings), None
    if settings.solver == "march":
        return march.first_hits(beams, metric, theta, size, settings), None
    if warm is None or not settings.warm_start:
        return cold_start(beams, metric, theta, size, settings, space)
    return warm_start(beams, metric, theta, size, warm, settings, space)


def assemble(
    beams: Beams,
    hits: FirstHits,
    field: ObjectField,
    theta: Tensor,
    settings: RenderSettings,
    warm: WarmStart | None = None,
) -> Rendering:
    """The scene with the hit points in place, differentiable where gradients are wanted."""
    evaluations, coarse = field.count.evaluations, field.count.coarse
    polish = settings.unchecked_m > 0
    known = None if warm is None else warm.tangents
    surface, hits, grazing, tangents = surface_points(beams, hits, field, theta, settings.grazing_floor, polish, known)
    if warm is not None:
        warm = replace(warm, tangents=None if tangents is None else tangents.without_graph())
    points = beams.points
    if len(hits.index):
        points = points.index_copy(0, hits.index, surface.to(points.dtype))
    hit_mask = torch.zeros(len(beams), dtype=torch.bool)
    hit_mask[hits.index] = True
    return Rendering(
        points,
        hit_mask,
        beams.ranges_m.index_copy(0, hits.index, hits.range_m),
        float(hits.residual_m.max()) if len(hits.index) else 0.0,
        len(hits.unresolved),
        evaluations,
        coarse,
        grazing,
        warm,
    )
