"""A scaled object in closed form, an object beyond every beam, and angles of the same attitude."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Field, Frame, in_frame, sphere
from hypothesis import given
from hypothesis import strategies as st
from property_worlds import ANGLES, EXACT, U64, draw, fan, few, known_to_m, poses, slopes, soft_cars
from torch import Tensor

from shift3d.render import Beams, Rendering, preset

POINTS = fan()
BEAMS = Beams.from_arrays(POINTS, np.zeros(3))
PRESETS = pytest.mark.parametrize("name", ["standard", "draft", "paper", "reference"])


def scaled(frame: Frame, factor: float) -> Frame:
    return replace(frame, scale_m=frame.scale_m * factor, size_m=tuple(edge * factor for edge in frame.size_m))


@few(10)
@given(factor=st.floats(0.25, 2.5), theta=poses())
@PRESETS
def test_a_scaled_sphere_is_where_geometry_puts_it(name: str, factor: float, theta: Tensor) -> None:
    """The range of a beam e through a sphere of radius r about c is e c - sqrt(r^2 - d^2), d its distance from c."""
    settings = preset(name)
    unit = Frame(size_m=(2.0, 2.0, 2.0), scale_m=1.05, sdf_R_object=SHAPENET_FRAME.sdf_R_object)
    frame, radius_m = scaled(unit, factor), factor
    drawn = draw(BEAMS, in_frame(sphere(1.0), unit), theta, settings, frame)
    along = BEAMS.directions @ theta[:3]
    off_m = (theta[:3] - along[:, None] * BEAMS.directions).norm(dim=-1)
    half_m = (radius_m**2 - off_m**2).clamp_min(0.0).sqrt()
    assert not bool(drawn.hit_mask[off_m > radius_m + 1e-6].any())
    # Every chord longer than a step is found.
    assert bool(drawn.hit_mask[2 * half_m > 1.01 * settings.step_m].all())
    hit = drawn.hit_mask & (half_m > 0.05 * radius_m)
    # |e . grad g| is half / r there, and rounding adds the API's statement. Coordinates: the sphere's norm is taken of
    # three of them, so it is off by u as often again. The paper's bisections end at 0.1 m / 2^30.
    value_m = (settings.tolerance_m if name != "paper" else 0.0) + 2 * settings.reachable_residual_m(frame.scale_m)
    bound = value_m * radius_m / half_m[hit] + (settings.step_m / 2**30 if name == "paper" else 0.0)
    assert bool(((drawn.range_m - (along - half_m))[hit].abs() <= bound * (1 + settings.tolerance_m / 0.01)).all())


@few(10)
@given(factor=st.floats(0.5, 2.0), theta=poses(), field=soft_cars())
def test_a_world_twice_the_size_is_seen_from_twice_as_far(factor: float, theta: Tensor, field: Field) -> None:
    bigger = theta * torch.tensor([factor] * 3 + [1.0] * 3, dtype=torch.float64)
    settings = EXACT.with_(
        step_m=EXACT.step_m * factor, max_step_m=EXACT.max_step_m * factor, box_margin_m=EXACT.box_margin_m * factor
    )
    before = draw(BEAMS, field, theta)
    beams = Beams.from_arrays(POINTS * factor, np.zeros(3))
    after = draw(beams, field, bigger, settings, scaled(SHAPENET_FRAME, factor))
    slope = slopes(before, BEAMS, field, theta)
    both = before.hit_mask & after.hit_mask
    # Every length of the renderer scales along, except the spacing of its samples of flat crossings, which alone find
    # only a few chords.
    assert int((before.hit_mask ^ after.hit_mask).sum()) <= 1 and both.sum() > 10
    change = (after.range_m / factor - before.range_m)[both].abs()
    slope = slope[both[before.hit_mask]]
    known_m = known_to_m(slope, before.range_m[both]) + known_to_m(slope, after.range_m[both]) / factor
    assert bool((change <= known_m + 16 * U64 * 40.0 / slope).all())


@few(15)
@given(
    direction=st.tuples(ANGLES, st.floats(-1.5, 1.5)), beyond_m=st.floats(8.0, 1e5), attitude=st.tuples(*[ANGLES] * 3)
)
@PRESETS
def test_an_object_beyond_every_beam_changes_nothing_bit_for_bit(
    name: str, direction: tuple[float, float], beyond_m: float, attitude: tuple[float, ...]
) -> None:
    """The object is farther than every return by more than the radius of the sphere about it, 7 m."""
    azimuth, elevation = direction
    way = [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
    points = np.concatenate((POINTS.astype(np.float32), np.float32([[0, 0, 0], [np.nan, 1, 1], [-np.inf, 0, 0]])))
    theta = torch.tensor([*((40.0 + beyond_m) * np.array(way)), *attitude], dtype=torch.float64, requires_grad=True)
    beams = Beams.from_arrays(points, np.zeros(3, np.float32))
    drawn = draw(beams, in_frame(sphere(1.0), SHAPENET_FRAME), theta, preset(name))
    assert drawn.points.numpy().tobytes() == points.tobytes()
    assert torch.equal(drawn.range_m, beams.ranges_m)
    assert (drawn.object_points, drawn.unresolved_beams, drawn.max_residual_m) == (0, 0, 0.0)
    assert not drawn.points.requires_grad


@few(12)
@given(theta=poses(), field=soft_cars(), which=st.sampled_from([3, 4, 5]), turns=st.integers(-3, 3))
def test_an_angle_of_pi_is_one_of_minus_pi(theta: Tensor, field: Field, which: int, turns: int) -> None:
    """An angle a + 2 pi n is stored to u |a + 2 pi n|, and pi itself is no float64: the object may turn by that."""

    def at(angle: float) -> tuple[Rendering, Tensor]:
        pose = theta.clone()
        pose[which] = angle
        pose.requires_grad_()
        drawn = draw(BEAMS, field, pose)
        (gradient,) = torch.autograd.grad(drawn.points.sin().sum(), pose)
        return drawn, gradient

    (one, gradient_one), (other, gradient_other) = at(math.pi), at(-math.pi + 2 * math.pi * turns)
    turned = 2 * U64 * math.pi * (1 + 2 * abs(turns))
    pose = theta.clone()
    pose[which] = math.pi
    slope = slopes(one, BEAMS, field, pose)
    bound = (turned * 3.0 + 16 * U64 * 40.0) / slope + 2 * known_to_m(slope, one.range_m[one.hit_mask])
    assert torch.equal(one.hit_mask, other.hit_mask) and one.hit_mask.sum() > 10
    assert bool(((one.range_m - other.range_m)[one.hit_mask].abs() <= bound).all())
    # A range's derivative by an angle is g_angle / slope. If the hit moves by d, the derivative changes by up to d (8 /
    # m)(2.5 m)(1 / slope + 1 / slope^2): curvatures of these shapes are below 8 / m (2.4 m over 0.56 m squared), arms
    # below 2.5 m, slopes floored. The loss weighs each of three coordinates by at most 1.
    moved = 3 * float((bound * 20.0 * 2.0 / EXACT.min_n_dot_d**2).sum())
    assert float((gradient_one - gradient_other).abs().max()) <= moved
