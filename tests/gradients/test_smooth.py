"""A derivative by hand, and the same derivative from both renderers."""

import pytest
import torch
from analytic_fields import SHAPENET_FRAME, in_frame, soft_car, sphere
from gradient_cases import EXACT, analytic, relative_error
from gradient_catalogue import CODE, THETA, inner_beams

from shift3d.render import Beams, preset, render


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
    field, beams = in_frame(soft_car(CODE), SHAPENET_FRAME), inner_beams("soft car")
    fast, _ = analytic(lambda t: render(beams, field, t, SHAPENET_FRAME, EXACT), THETA)
    paper = preset("paper").with_(dtype=torch.float64)
    plain, _ = analytic(lambda t: render(beams, field, t, SHAPENET_FRAME, paper), THETA)
    assert relative_error(plain, fast) < 1e-5
