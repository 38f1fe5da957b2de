"""Entry point of the renderer: insert an object into a scene."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render.beams import Beams
from shift3d.render.field.object_field import Field, ObjectField, VehicleFrame
from shift3d.render.field.sdf_grid import SdfGrid, vehicle_size
from shift3d.render.implicit import surface_points, wants_gradient
from shift3d.render.rendering import Rendering
from shift3d.render.settings import STANDARD, RenderSettings
from shift3d.render.solvers import paper, piecewise_linear, search, sphere_tracing
from shift3d.render.solvers.search import WarmStart


def render(
    beams: Beams,
    field: Field,
    theta: Tensor,
    vehicle: VehicleFrame,
    settings: RenderSettings = STANDARD,
    warm: WarmStart | None = None,
    grid: SdfGrid | None = None,
) -> Rendering:
    """Move every return whose beam meets the object to the first crossing of the object's surface.

    Args:
        beams: the scene's beams, scene frame.
        field: signed distance in the vehicle's sdf frame, negative inside, in `settings.dtype`. A decoder of less
            precision leaves its own rounding in every hit: some 2e-7 m in float32.
        theta: (6,) x, y, z, yaw, pitch, roll of the object in the scene frame; metres, radians.
        vehicle: scale and axes of the sdf frame, size of the baseline.
        settings: every approximation.
        warm: `Rendering.warm` of an earlier rendering of the same beams and vehicle with a similar code or pose.
        grid: `SdfGrid.of` this very field, for fields that are rendered often. Used by `sphere_tracing` alone.
    Returns: Rendering. Its points are differentiable w.r.t. theta and the field's latent code.
    Raises:
        InputError: the pose is not six finite numbers; the dtype cannot reach the tolerance on this vehicle; the
            vehicle does not fit into the paper's sphere.
    Source: SHIFT3D, Object Rendering in LiDAR scene.
    """
    if theta.shape != (6,) or not bool(torch.isfinite(theta).all()):
        raise InputError("a pose is six finite numbers: x, y, z, yaw, pitch, roll", where=f"pose {theta.tolist()}")
    settings.check_tolerance(float(vehicle.scale_m))
    metric = ObjectField.of(field, vehicle, settings.dtype, settings.batch, settings.bfloat16_band_m)
    state = None
    if settings.final_newton_m and not wants_gradient(theta, metric.depends_on_code()):
        settings = settings.with_(final_newton_m=0.0)
    grid, size = grid if settings.sdf_grid else None, vehicle_size(vehicle)
    with torch.no_grad():
        if settings.solver == "paper":
            paper.check_size(size)
            hits = paper.first_hits(beams, metric, theta, settings)
        elif settings.solver == "piecewise_linear" and metric.piecewise_linear():
            hits = piecewise_linear.first_hits(beams, metric, theta, size, settings)
        elif settings.solver == "plain_sphere_tracing":
            hits = sphere_tracing.first_hits(beams, metric, theta, size, settings)
        else:
            warm = warm if settings.warm_start else None
            hits, state = search.first_hits(beams, metric, theta, size, settings, warm, grid)
    evaluations, coarse = metric.count.evaluations, metric.count.coarse
    polish, known = settings.final_newton_m > 0, None
    if state is not None:
        metric, known = metric.sliced(state.live), state.linearization
    surface, hits, grazing, at_hits = surface_points(beams, hits, metric, theta, settings.min_n_dot_d, polish, known)
    if state is not None:
        state = replace(state, linearization=None if at_hits is None else at_hits.without_graph())
    points = beams.points
    if len(hits.index):
        points = points.index_copy(0, hits.index, surface.to(points.dtype))
    return Rendering(
        points,
        torch.zeros(len(beams), dtype=torch.bool).index_fill(0, hits.index, True),
        beams.ranges_m.index_copy(0, hits.index, hits.range_m),
        float(hits.residual_m.max()) if len(hits.index) else 0.0,
        len(hits.unresolved),
        evaluations,
        coarse,
        grazing,
        state,
    )
