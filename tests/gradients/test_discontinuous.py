"""Discontinuities: a hit about to jump to another surface has the derivative of its own side."""

import torch
from analytic_fields import SHAPENET_FRAME, box, in_frame, union
from gradient_cases import EXACT
from torch import Tensor

from shift3d.render import Beams, render

THETA = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
# A post at x = -0.5 before a slab at x = 0.5; beams at y just inside and just outside the post's edge.
FIELD = in_frame(union(box((0.05, 0.3, 1.0), (-0.5, 0.0, 0.0)), box((0.2, 1.0, 1.0), (0.7, 0.0, 0.0))), SHAPENET_FRAME)


def points_at(y: float, theta: Tensor) -> Tensor:
    beams = Beams.from_arrays(
        torch.tensor([[30.0, y, 0.0]], dtype=torch.float64), torch.tensor([0.0, y, 0.0], dtype=torch.float64)
    )
    return render(beams, FIELD, theta, SHAPENET_FRAME, EXACT).points


def test_each_side_of_the_jump_has_its_own_derivative() -> None:
    for y, depth, arm in ((0.2999, 9.45, -0.55), (0.3001, 10.5, 0.5)):
        theta = THETA.clone().requires_grad_()
        point = points_at(y, theta)[0]
        assert abs(float(point[0].detach()) - depth) < 1e-9
        (gradient,) = torch.autograd.grad(point[0], theta)
        # The face moves with x; turning by yaw moves it by -(lateral offset).
        expected = torch.tensor([1.0, 0.0, 0.0, -y, 0.0, 0.0], dtype=torch.float64)
        assert torch.allclose(gradient, expected, atol=1e-6), arm


def test_no_hit_has_no_gradient_and_a_hit_beside_it_keeps_its_own() -> None:
    theta = THETA.clone().requires_grad_()
    beams = Beams.from_arrays(torch.tensor([[30.0, 0.0, 0.0], [30.0, 25.0, 0.0]], dtype=torch.float64), torch.zeros(3))
    rendering = render(beams, FIELD, theta, SHAPENET_FRAME, EXACT)
    assert rendering.hit_mask.tolist() == [True, False]
    (gradient,) = torch.autograd.grad(rendering.points[1].sum(), theta)
    assert torch.equal(gradient, torch.zeros(6, dtype=torch.float64))
