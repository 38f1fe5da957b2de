"""Renderer: rows without a beam, coordinates far away, poses, scenes without a hit, batches."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from analytic_fields import car, in_frame, sector_scan, sphere
from catalogue import hard_case
from hard_scenes import (
    FAST,
    PLAIN,
    PRESETS,
    beams_along_x,
    draw,
    fan,
    pose,
    unmoved,
)
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render import Beams, SdfGrid


@hard_case(
    area="renderer",
    why="a return at the sensor itself has no direction, and what a scan lost is written as such",
    must="the row carries no beam, is not counted, and its copies and neighbours are hit as ever",
    guard="a row carries a beam only where its range is above zero",
)
def rows_without_a_return() -> None:
    points = np.array([[0, 0, 0], [np.nan, 0, 0], [30, 0, 0], [30, 0, 0], [0, 0, 0]], np.float64)
    for settings in PRESETS.values():
        rendering = draw(Beams.from_arrays(points, np.zeros(3)), sphere(1.0), settings=settings)
        assert rendering.hit_mask.tolist() == [False, False, True, True, False]
        assert torch.equal(rendering.points[2], rendering.points[3])
        assert np.array_equal(rendering.points[[0, 1, 4]].numpy(), points[[0, 1, 4]], equal_nan=True)
        inside = draw(Beams.from_arrays(points[[0, 4]], np.zeros(3)), sphere(1.0), pose(), settings)
        assert inside.unresolved_beams == 0


@hard_case(
    area="renderer",
    why="an infinite coordinate has an infinite range and no direction",
    must="the row carries no beam, and no direction or range of the scene is NaN or infinite",
    guard="a row carries a beam only where its range is finite",
)
def rows_at_infinity() -> None:
    points = np.array([[np.inf, 0, 0], [-np.inf, np.inf, 1], [30, 0, 0]], np.float32)
    beams = Beams.from_arrays(points, np.zeros(3))
    assert torch.isfinite(beams.directions).all() and torch.isfinite(beams.ranges_m).all()
    for settings in PRESETS.values():
        rendering = draw(beams, sphere(1.0), settings=settings)
        assert torch.isfinite(rendering.range_m).all()
        assert rendering.hit_mask.tolist() == [False, False, True]
        assert torch.equal(rendering.points[:2], beams.points[:2])


@hard_case(
    area="renderer",
    why="at 20 km from the origin float32 coordinates are 2 mm apart, and a sensor's place is rounded as well",
    must="ranges as if the origin were at the sensor, to a micrometre",
    guard="a beam is the difference of its ends, taken in float64",
)
def returns_in_float32_far_from_the_origin() -> None:
    far = np.array([20_000.0003, -12_000.0007, 120.0004])
    points, _ = sector_scan((12.0, 3.0, -1.0), rays=10)
    rounded = (points + far).astype(np.float32)
    here, there = pose(12.0, 3.0, -1.0, 0.4), pose(12.0, 3.0, -1.0, 0.4)
    there[:3] += torch.from_numpy(far)
    for settings in PRESETS.values():
        near = draw(Beams.from_arrays(rounded.astype(np.float64) - far, np.zeros(3)), car(), here, settings)
        away = draw(Beams.from_arrays(rounded, far), car(), there, settings)
        assert torch.equal(near.hit_mask, away.hit_mask) and near.object_points > 20
        assert float((near.range_m - away.range_m).abs().max()) < 1e-6


@hard_case(
    area="renderer",
    why="in a map's own coordinates a pose is kilometres large and its differences from a beam are metres",
    must="ranges as near the origin, to a hundredth of a millimetre, whatever dtype the field has",
    guard="beams are moved to the object in float64, the field's dtype comes after that",
)
def a_pose_far_from_the_origin() -> None:
    far = np.array([15_600.0, 4_200.0, 120.0]) + 0.0003
    points, origin = sector_scan((12.0, 3.0, -1.0), rays=10, far_m=40.03)
    here, there = pose(12.0006, 3.0003, -1.0, 0.4), pose(12.0006, 3.0003, -1.0, 0.4)
    there[:3] += torch.from_numpy(far)
    for settings in PRESETS.values():
        for dtype in (torch.float64, torch.float32):
            chosen = settings.with_(dtype=dtype, tolerance_m=max(settings.tolerance_m, 1e-6))
            near = draw(Beams.from_arrays(points, origin), car(), here, chosen)
            away = draw(Beams.from_arrays(points + far, origin + far), car(), there, chosen)
            assert torch.equal(near.hit_mask, away.hit_mask) and near.object_points > 20
            assert float((near.range_m - away.range_m).abs().max()) < 1e-5


@hard_case(
    area="renderer",
    why="a pose that an optimiser holds in float32 meets beams in float64",
    must="it is rendered, to the rounding of the pose itself",
    guard="the pose is taken to float64 before the beams are moved by it",
)
def a_pose_in_float32() -> None:
    theta = pose(12.0, 3.0, -1.0, 0.4)
    for settings in PRESETS.values():
        whole = draw(fan(theta, 10), car(), theta, settings)
        rounded = draw(fan(theta, 10), car(), theta.float(), settings)
        assert whole.object_points > 20 and torch.equal(whole.hit_mask, rounded.hit_mask)
        assert float((whole.range_m - rounded.range_m).abs().max()) < 1e-4


@hard_case(
    area="renderer",
    why="one NaN in a pose makes every beam miss: the object would silently be gone",
    must="an input error that shows the pose",
    guard="a pose is looked at before anything is rendered",
)
def a_pose_that_is_not_finite() -> None:
    for bad in (math.nan, math.inf):
        for settings in PRESETS.values():
            try:
                draw(beams_along_x(), sphere(1.0), pose(10.0, 0.0, bad), settings)
            except InputError as error:
                assert "pose" in str(error)
            else:
                raise AssertionError(f"a pose with {bad} was rendered")


@hard_case(
    area="renderer",
    why="several sensors, or one that drives while it turns: two beams to one point start at different places",
    must="each beam is followed from its own sensor, two returns of one beam are two beams",
    guard="the first origin stands for all only where all are one row of memory",
)
def beams_of_two_sensors() -> None:
    points = np.array([[20.0, 0.0, 0.0], [20.0, 0.0, 0.0], [8.0, 0.0, 0.0]])
    origins = np.array([[0.0, 30.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for settings in PRESETS.values():
        rendering = draw(Beams.from_arrays(points, origins), sphere(1.0), settings=settings)
        assert rendering.hit_mask.tolist() == [False, True, False]
        assert abs(float(rendering.range_m[1]) - 9.0) < 1e-4 and float(rendering.range_m[2]) == 8.0


@hard_case(
    area="renderer",
    why="the SDF grid samples as far as the longest of its rays, and there may be none",
    must="nothing moves, nothing is evaluated beyond the box itself, no hit has no residual",
    guard="no ray at all has length zero",
)
def no_beam_through_the_box() -> None:
    space = SdfGrid.of(_SPHERE, PLAIN, FAST)
    for beams in (beams_along_x(y=60.0), beams_along_x(start_x=20.0), Beams.from_arrays(np.zeros((0, 3)), np.zeros(3))):
        for settings in PRESETS.values():
            rendering = draw(beams, sphere(1.0), settings=settings, frame=PLAIN, space=space)
            unmoved(rendering, beams)
            assert rendering.points.shape == (len(beams), 3) and rendering.max_residual_m == 0.0


@hard_case(
    area="renderer",
    why="without a hit there is no largest residual and no gradient to take",
    must="the scene itself, residual 0, and no graph",
    guard="the residual of no hits is 0",
)
def no_hit_at_all() -> None:
    beams = fan(pose(12.0, 3.0))
    for settings in PRESETS.values():
        for metric in (sphere(1.0), lambda x: torch.full_like(x[:, 0], 0.3)):
            theta = pose(12.0, 9.0).requires_grad_()
            rendering = draw(beams, metric, theta, settings)
            unmoved(rendering, beams)
            assert rendering.max_residual_m == 0.0 and not rendering.points.requires_grad


@hard_case(
    area="renderer",
    why="the paper's march sizes its memory by the longest beam, and no beam may pass the sphere",
    must="no hit, none unresolved",
    guard="a scene without a beam near the object is done at once",
)
def no_beam_past_the_sphere() -> None:
    beams = beams_along_x()
    for settings in PRESETS.values():
        unmoved(draw(beams, sphere(1.0), pose(10.0, 60.0), settings), beams)


@hard_case(
    area="renderer",
    why="all samples of a scene at once do not fit the memory of a worker",
    must="never more points at once than the batch, and the same bits as in one go",
    guard="points are handed to the field a batch at a time",
)
def more_points_than_a_batch() -> None:
    theta = pose(12.0, 3.0, -1.0, 0.4)
    beams = fan(theta, rays=10)
    for settings in PRESETS.values():
        chosen = settings.with_(sphere_chord_only=True)
        whole = draw(beams, car(), theta, chosen.with_(batch=1_000_000))
        parts = draw(beams, _refusing_more_than(199), theta, chosen.with_(batch=199))
        assert whole.object_points > 20 and torch.equal(whole.points, parts.points)
        assert whole.evaluations == parts.evaluations


def _refusing_more_than(count: int) -> Callable[[Tensor], Tensor]:
    """Return the car's field, which accepts at most `count` points per call."""

    def g(x: Tensor) -> Tensor:
        assert len(x) <= count, "more points than a batch"
        return car()(x)

    return g


_SPHERE = in_frame(sphere(1.0), PLAIN)
