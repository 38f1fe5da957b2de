"""Moving silhouettes: the bound on the gradient of grazing beams, and the share that these beams carry."""

import pytest
import torch
from analytic_fields import SHAPENET_FRAME, in_frame, sphere
from gradient_cases import EXACT
from gradient_catalogue import THETA, fan

from shift3d.render import Beams, Rendering, render


@pytest.mark.parametrize("offset", [0.999, 0.99999, 0.9999999])
def test_the_floor_bounds_the_gradient_of_a_grazing_beam(offset: float) -> None:
    # One beam at this share of the sphere's radius: |e . grad g| = sqrt(1 - offset^2).
    points = torch.tensor([[30.0, offset, 0.0]], dtype=torch.float64)
    beams = Beams.from_arrays(points, torch.tensor([0.0, offset, 0.0], dtype=torch.float64))
    theta = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)

    def slope(floor: float) -> tuple[float, Rendering]:
        radius = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
        settings = EXACT.with_(step_m=1e-4, min_n_dot_d=floor)
        rendering = render(beams, in_frame(sphere(radius), SHAPENET_FRAME), theta, SHAPENET_FRAME, settings)
        assert rendering.object_points == 1
        rendering.points[0, 0].backward()
        assert radius.grad is not None
        return float(radius.grad), rendering

    exact = -1.0 / (1.0 - offset**2) ** 0.5
    free, _ = slope(0.0)
    floored, rendering = slope(0.05)
    assert free == pytest.approx(exact, rel=2e-2)
    assert floored == pytest.approx(max(exact, -20.0), rel=1e-6)
    grazing = exact < -20.0
    assert (rendering.grazing.beams, rendering.grazing.gradient) == ((1, 1.0) if grazing else (0, 0.0))


def test_the_share_of_grazing_beams_is_reported() -> None:
    beams, field = fan(61), in_frame(sphere(1.0), SHAPENET_FRAME)
    theta = THETA.clone().requires_grad_()
    rendering = render(beams, field, theta, SHAPENET_FRAME, EXACT.with_(min_n_dot_d=0.2))
    assert rendering.grazing.gradient == 0.0
    rendering.points.sum().backward()
    assert 0.0 < rendering.grazing.gradient < 0.5
    assert 0 < rendering.grazing.beams < rendering.object_points
