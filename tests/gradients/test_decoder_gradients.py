"""The published architecture: dL/dz over all 256 numbers in some directions, dL/dtheta, in float64.

A ReLU network's slope jumps where a unit switches. A step of 1e-6 stays within a linear piece almost everywhere. The
tolerance of 1e-3, which the project promises, covers the few beams whose piece ends within a step.
"""

from collections.abc import Callable

import pytest
import torch
from analytic_fields import Frame, sector_scan
from gradient_cases import EXACT, GradientCase, relative_error, select, wavy_loss
from torch import Tensor

from shift3d.render import Beams, Rendering, render
from shift3d.sdf.decoder import Decoder, load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles

THETA = torch.tensor([13.0, 2.0, -1.0, 0.8, 0.02, -0.03], dtype=torch.float64)


@pytest.fixture(scope="module")
def shapes() -> tuple[Decoder, Tensor, Frame]:
    """The shipped decoder with a car's code."""
    v = baseline_vehicles()["suv"]
    frame = Frame(v.size_m, v.scale_m, v.sdf_R_object, v.sdf_t_object)
    return load_decoder().double(), torch.from_numpy(v.latent_code).double(), frame


def drawing(decoder: Decoder, frame: Frame, beams: Beams) -> Callable[[Tensor, Tensor], Rendering]:
    return lambda code, theta: render(beams, decoder.field(code), theta, frame, EXACT)


def hit_beams(decoder: Decoder, code: Tensor, frame: Frame) -> Beams:
    beams = Beams.from_arrays(*sector_scan((13.0, 2.0, -1.0), half_angle_rad=0.13, rays=7))
    with torch.no_grad():
        rows = torch.nonzero(drawing(decoder, frame, beams)(code, THETA).hit_mask).squeeze(1)
    assert len(rows) > 20
    return select(beams, rows)


def drawn(at: Tensor) -> Tensor:
    """Return two random directions."""
    found = torch.randn(2, len(at), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return torch.nn.functional.normalize(found, dim=1)


def case(shapes: tuple[Decoder, Tensor, Frame], variable: str) -> GradientCase:
    decoder, code, frame = shapes
    beams = hit_beams(decoder, code, frame)
    draw = drawing(decoder, frame, beams)

    def of_code(z: Tensor) -> tuple[Tensor, Tensor]:
        rendering = draw(z, THETA)
        return wavy_loss(rendering.points), rendering.hit_mask

    def of_pose(theta: Tensor) -> tuple[Tensor, Tensor]:
        rendering = draw(code, theta)
        return wavy_loss(rendering.points), rendering.hit_mask

    if variable == "pose":
        return GradientCase("pose of the decoder's car", "discontinuous", of_pose, THETA, 1e-6, 1e-3, drawn(THETA))
    leaf = code.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(of_code(leaf)[0], leaf)
    directions = torch.cat((torch.nn.functional.normalize(gradient[None], dim=1), drawn(code)))
    return GradientCase("code of the decoder's car", "discontinuous", of_code, code, 1e-6, 1e-3, directions)


@pytest.mark.parametrize("variable", ["pose", "code"])
def test_gradient(shapes: tuple[Decoder, Tensor, Frame], variable: str) -> None:
    checked = case(shapes, variable)
    assert relative_error(checked.gradient(), checked.differences(checked.step)) < checked.tolerance
