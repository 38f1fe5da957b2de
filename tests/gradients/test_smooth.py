"""Smooth cases: beams that meet the surface away from its silhouette. Tolerance 1e-6, steps 1e-5."""

import pytest
import torch
from analytic_fields import SHAPENET_FRAME, car, in_frame, sector_scan, soft_car, sphere
from gradient_cases import EXACT, analytic, differences, relative_error, select
from torch import Tensor

from shift3d.geometry.se3 import scene_R_object
from shift3d.render import Beams, Rendering, render

THETA = torch.tensor([12.0, 4.0, -0.9, 0.7, 0.04, -0.06], dtype=torch.float64)
CODE = torch.tensor([0.3, -0.2, 0.1, 0.5, -0.4, 0.8], dtype=torch.float64)


def inner_beams(field, theta: Tensor = THETA) -> Beams:  # type: ignore[no-untyped-def]
    """Beams that meet the surface at more than 17 degrees."""
    x, y, z = (float(v) for v in theta[:3])
    beams = Beams.from_arrays(*sector_scan((x, y, z), half_angle_rad=0.15, rays=20))
    with torch.no_grad():
        rendering = render(beams, field, theta, SHAPENET_FRAME, EXACT)
    rows = torch.nonzero(rendering.hit_mask).squeeze(1)
    x_object = ((rendering.points[rows] - theta[:3]) @ scene_R_object(theta)).requires_grad_()
    x_sdf = x_object @ torch.as_tensor(SHAPENET_FRAME.sdf_R_object).T / SHAPENET_FRAME.scale_m
    g = field(x_sdf + torch.as_tensor(SHAPENET_FRAME.sdf_t_object)) * SHAPENET_FRAME.scale_m
    (normal,) = torch.autograd.grad(g.sum(), x_object)
    facing = (normal * (beams.directions[rows] @ scene_R_object(theta))).sum(-1) < -0.3
    assert facing.sum() > 30
    return select(beams, rows[facing])


def test_shape_gradient_of_a_coded_shape() -> None:
    beams = inner_beams(in_frame(soft_car(CODE), SHAPENET_FRAME))

    def draw(code: Tensor) -> Rendering:
        return render(beams, in_frame(soft_car(code), SHAPENET_FRAME), THETA, SHAPENET_FRAME, EXACT)

    found, _ = analytic(draw, CODE)
    expected, held = differences(draw, CODE, 1e-5)
    assert held and relative_error(found, expected) < 1e-6


@pytest.mark.parametrize("metric", [sphere(1.1), soft_car(CODE), car()], ids=["sphere", "soft car", "car"])
def test_pose_gradient(metric) -> None:  # type: ignore[no-untyped-def]
    field = in_frame(metric, SHAPENET_FRAME)
    beams = inner_beams(field)
    if metric is not None:
        # An edge of the car may lie between two beams' positions only if the step is small against the fan.
        step = 1e-6

    def draw(theta: Tensor) -> Rendering:
        return render(beams, field, theta, SHAPENET_FRAME, EXACT)

    found, _ = analytic(draw, THETA)
    expected, held = differences(draw, THETA, step)
    assert held and relative_error(found, expected) < 1e-5


def test_shape_and_pose_gradients_in_one_backward_pass() -> None:
    beams = inner_beams(in_frame(soft_car(CODE), SHAPENET_FRAME))
    both = torch.cat((CODE, THETA))

    def draw(v: Tensor) -> Rendering:
        return render(beams, in_frame(soft_car(v[:6]), SHAPENET_FRAME), v[6:], SHAPENET_FRAME, EXACT)

    found, _ = analytic(draw, both)
    expected, held = differences(draw, both, 1e-5)
    assert held and relative_error(found, expected) < 1e-5


def test_a_sphere_by_hand() -> None:
    # The beam through the centre: dx/dradius = -e, and moving the sphere along the beam moves the point with it.
    theta = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64, requires_grad=True)
    radius = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    beams = Beams.from_arrays(torch.tensor([[30.0, 0.0, 0.0]], dtype=torch.float64), torch.zeros(3))
    rendering = render(beams, in_frame(sphere(radius), SHAPENET_FRAME), theta, SHAPENET_FRAME, EXACT)
    rendering.points[0, 0].backward()
    assert radius.grad is not None and theta.grad is not None
    assert float(radius.grad) == pytest.approx(-1.0, abs=1e-9)
    assert theta.grad.tolist() == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-9)


def test_both_renderers_give_the_same_gradient() -> None:
    from shift3d.render import preset

    field = in_frame(soft_car(CODE), SHAPENET_FRAME)
    beams = inner_beams(field)
    fast, _ = analytic(lambda t: render(beams, field, t, SHAPENET_FRAME, EXACT), THETA)
    paper = preset("paper").with_(dtype=torch.float64)
    plain, _ = analytic(lambda t: render(beams, field, t, SHAPENET_FRAME, paper), THETA)
    assert relative_error(plain, fast) < 1e-5
