"""Gradient: grazing beams, slopes of zero, roots polished by a last step, poses at the limits of their angles."""

from __future__ import annotations

import math

import numpy as np
import torch
from analytic_fields import Field, Frame, car, sphere
from catalogue import hard_case
from hard_scenes import AT_TEN, FAST, PAPER, PLAIN, PRESETS, beams_along_x, draw, fan, hit_at, pose, sound
from torch import Tensor

from shift3d.render import Beams, Rendering, RenderSettings
from shift3d.render.culling import Rays
from shift3d.render.field.object_field import ObjectField
from shift3d.render.solvers.corrector import correct

SPHERE = sphere(1.0)


def descended(
    beams: Beams, metric: Field, theta: Tensor = AT_TEN, settings: RenderSettings = FAST
) -> tuple[Rendering, Tensor]:
    """Return a rendering and the gradient of the sum of its coordinates with respect to the pose."""
    theta = theta.detach().clone().requires_grad_()
    rendering = draw(beams, metric, theta, settings, frame=PLAIN)
    rendering.points.sum().backward()
    assert theta.grad is not None
    return rendering, theta.grad


@hard_case(
    area="gradient",
    why="at the silhouette the derivative of the range grows without bound, and the next step may lose the beam",
    must="sign and direction stay, no motion is amplified more than five times, the share of such beams is told",
    guard="the slope that a gradient is divided by is no smaller than the grazing floor",
)
def a_beam_that_grazes() -> None:
    beams = beams_along_x(0.9999)
    for name in ("standard", "reference"):
        rendering, gradient = descended(beams, SPHERE, settings=PRESETS[name])
        assert rendering.object_points == 1 and rendering.grazing.beams == 1 and rendering.grazing.gradient == 1.0
        assert float(gradient[0]) > 0.0 > float(gradient[1]) and float(gradient.norm()) < 12.0
    # The paper has no floor.
    _, free = descended(beams, SPHERE, settings=PAPER.with_(step_m=0.005))
    assert abs(float(free[1])) > 60.0


@hard_case(
    area="gradient",
    why="a field that is flat on both sides of its jump has a slope of exactly zero",
    must="no gradient, and no NaN, where the paper's formula divides zero by zero",
    guard="a slope of zero has no inverse",
)
def a_slope_of_exactly_zero() -> None:
    def dead(x: Tensor) -> Tensor:
        return torch.where(SPHERE(x) < 0, -1.0, 1.0) + 0.0 * x.sum(-1)

    for settings in PRESETS.values():
        rendering, gradient = descended(beams_along_x(), dead, settings=settings.with_(min_n_dot_d=0.0))
        hit_at(rendering, 9.0)
        sound(rendering)
        assert torch.equal(gradient, torch.zeros(6, dtype=torch.float64))


@hard_case(
    area="gradient",
    why="a saturated tanh has a slope of thousands at its root and of nothing beside it",
    must="the gradient of the surface, whatever the field's own scale",
    guard="the root is reached before the slope is taken",
)
def a_saturated_field_has_the_gradient_of_its_surface() -> None:
    beams = beams_along_x(0.3)
    _, plain = descended(beams, SPHERE)
    for steepness in (1e2, 1e4):
        saturated = lambda x, steepness=steepness: torch.tanh(steepness * SPHERE(x))  # noqa: E731
        for settings in (PRESETS["standard"], PRESETS["reference"]):
            _, gradient = descended(beams, saturated, settings=settings)
            assert float((gradient - plain).abs().max()) < 1e-4


@hard_case(
    area="gradient",
    why="Newton's step at a grazing beam, where the slope is nearly zero, may lead anywhere along it",
    must="grazing hits are where a rendering without a gradient has them",
    guard="a root is polished only where the slope is below -0.05",
)
def a_root_on_a_grazing_beam_is_not_polished() -> None:
    chord = np.linspace(0.0005, 0.05, 100)
    y, zero = np.sqrt(1.0 - (chord / 2) ** 2), np.zeros(100)
    beams = Beams.from_arrays(np.stack([zero + 30.0, y, zero], 1), np.stack([zero, y, zero], 1))
    found, _ = descended(beams, SPHERE)
    plain = draw(beams, SPHERE, frame=PLAIN)
    assert plain.object_points >= 95 and torch.equal(found.hit_mask, plain.hit_mask)
    assert float((found.range_m.detach() - plain.range_m).abs().max()) < 1e-4


@hard_case(
    area="gradient",
    why="a field that jumps over zero has a large |g| and a fine slope at its surface: Newton's step leaves it",
    must="the hit stays at the jump, and its residual is returned",
    guard="a root is polished by no more than 2 mm",
)
def a_root_is_not_polished_far() -> None:
    torn = lambda x: SPHERE(x) + torch.where(SPHERE(x) < 0, -0.05, 0.05)  # noqa: E731
    rendering, gradient = descended(beams_along_x(), torn)
    hit_at(rendering, 9.0)
    assert abs(rendering.max_residual_m - 0.05) < 1e-4 and torch.isfinite(gradient).all()


@hard_case(
    area="gradient",
    why="a followed root can be a millimetre off when its gradient is taken",
    must="it is as good as one that was searched",
    guard="the gradient's own value and slope make one more Newton step",
)
def a_followed_root_is_polished() -> None:
    y = np.array([0.0, 0.5, 0.8, 0.95])
    beams = Beams.from_arrays(np.stack([y * 0 + 30.0, y, y * 0], 1), np.stack([y * 0, y, y * 0], 1))
    first = draw(beams, SPHERE, frame=PLAIN)
    for radius in (1.0002, 0.9997):
        theta = AT_TEN.clone().requires_grad_()
        found = draw(beams, sphere(radius), theta, warm=first.warm, frame=PLAIN)
        expected = 10.0 - (radius**2 - torch.from_numpy(y) ** 2).sqrt()
        assert found.hit_mask.all() and float((found.range_m.detach() - expected).abs().max()) < 1e-6


@hard_case(
    area="gradient",
    why="a loss that does not depend on the moved points sends them a gradient of zero",
    must="a gradient of zero, and a share of grazing beams of zero",
    guard="a share of nothing is zero",
)
def a_loss_that_no_point_moves() -> None:
    for settings in PRESETS.values():
        theta = AT_TEN.clone().requires_grad_()
        rendering = draw(beams_along_x(0.5), SPHERE, theta, settings)
        (rendering.points * 0.0).sum().backward()
        assert theta.grad is not None and torch.equal(theta.grad, torch.zeros(6, dtype=torch.float64))
        assert rendering.grazing.gradient == 0.0


@hard_case(
    area="gradient",
    why="an optimiser holds its pose in float32, the hits are float64",
    must="a gradient in the pose's own dtype, to the rounding of the pose",
    guard="points are moved by the pose in float64",
)
def the_gradient_of_a_pose_in_float32() -> None:
    theta = pose(12.0, 3.0, -1.0, 0.4)
    _, whole = descended(fan(theta, 10), car(), theta)
    _, rounded = descended(fan(theta, 10), car(), theta.float())
    assert rounded.dtype == torch.float32
    assert float((whole - rounded).norm() / whole.norm()) < 1e-3


@hard_case(
    area="gradient",
    why="at a pitch of a right angle yaw and roll turn about one axis, and formulas with a root or an arc fail",
    must="the derivative of a full re-render, by central differences",
    guard="a rotation is made of sines and cosines, no angle is taken out of one",
)
def a_pitch_at_a_right_angle() -> None:
    sharp = FAST.with_(tolerance_m=1e-11, max_iterations=80)
    for pitch in (math.pi / 2, -math.pi / 2):
        theta, beams = pose(10.0, 0.0, 0.0, 0.3, pitch, 0.2), beams_along_x(0.1, z=0.2)
        rendering, gradient = descended(beams, car(), theta, sharp)
        assert rendering.object_points == 1
        _agrees(gradient, beams, theta, sharp)


@hard_case(
    area="gradient",
    why="headings of pi, -pi and 3 pi are one",
    must="the same points and the same gradient, continuous across the wrap",
    guard="nothing but sine and cosine ever sees a heading",
)
def a_heading_at_the_wrap() -> None:
    at = pose(-12.0, 0.4, -1.0, math.pi, 0.02, 0.03)
    beams = fan(at, 12)
    same, gradient = descended(beams, car(), at)
    assert same.object_points > 20
    for yaw in (-math.pi, 3.0 * math.pi, math.pi - 1e-12, -math.pi + 1e-12):
        theta = at.clone()
        theta[3] = yaw
        found, other = descended(beams, car(), theta)
        assert torch.allclose(found.points, same.points, atol=1e-7)
        assert torch.allclose(gradient, other, rtol=1e-6, atol=1e-6)


def _agrees(gradient: Tensor, beams: Beams, theta: Tensor, settings: RenderSettings, step: float = 1e-6) -> None:
    """Check that the gradient is that of a full re-rendering, to 1e-5 of its length."""
    differences = torch.zeros(6, dtype=torch.float64)
    for i in range(6):
        moved = [theta.clone() for _ in range(2)]
        moved[0][i], moved[1][i] = moved[0][i] + step, moved[1][i] - step
        ahead, behind = (draw(beams, car(), m, settings, frame=PLAIN).points.sum() for m in moved)
        differences[i] = (ahead - behind) / (2.0 * step)
    assert float((gradient - differences).norm()) <= 1e-5 * float(differences.norm())


@hard_case(
    area="gradient",
    why="a beam grazes, and a crease lies 10 um in front of its root: within the tolerance |g| is small on both sides",
    must="the gradient is that of the root's side",
    guard="on a flat beam the tolerance and the final Newton threshold shrink with its slope",
)
def a_crease_just_before_the_root_of_a_grazing_beam() -> None:
    crease_m = -1e-5

    def grazed(x: Tensor) -> Tensor:
        before = -0.078 * (x[:, 0] - crease_m) - 0.075 * crease_m + 0.3 * x[:, 1]
        return torch.maximum(before, -0.075 * x[:, 0] + 0.05 * x[:, 1])

    origin, along = torch.tensor([[-3.0, 0.0, 0.0], [1.0, 0.0, 0.0]], dtype=torch.float64).split(1)
    near, far, start = torch.tensor([[0.0], [6.0], [2.99998]], dtype=torch.float64)
    for dtype in (torch.float32, torch.float64):
        settings = PRESETS["standard"].with_(dtype=dtype)
        field = ObjectField.of(grazed, Frame(), dtype, 4096)
        found = correct(Rays(torch.tensor([0]), origin, along, near, far), start, None, field, settings, 0.3)
        assert found.linearizations is not None and abs(float(found.range_m) - 3.0) < 1e-5
        assert torch.allclose(found.linearizations.gradient[0], torch.tensor([-0.075, 0.05, 0.0]).double())
