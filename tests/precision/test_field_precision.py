"""The metric field in float32 against float64, and the accuracy that the API states for each dtype, checked by both."""

import math

import numpy as np
import pytest
import torch
from rounding import EMPTY, U32, decoder_rounding, input_rounding
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render import PRESETS, Beams, RenderSettings, preset, render
from shift3d.render.field.object_field import ObjectField
from shift3d.render.settings import reachable_residual_m
from shift3d.sdf.decoder import load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles

SUV = baseline_vehicles()["suv"]
CODE = torch.from_numpy(SUV.latent_code)
SINGLE, DOUBLE = load_decoder().field(CODE), load_decoder().double().field(CODE.double())
F32 = ObjectField.of(SINGLE, SUV, torch.float32, 4096)
F64 = ObjectField.of(DOUBLE, SUV, torch.float64, 4096)


@pytest.fixture(scope="module")
def near_surface() -> Tensor:
    """Places (400, 3) in the object frame, the nearest to the surface of some thousands."""
    generator = torch.Generator().manual_seed(0)
    place = torch.rand(2000, 3, generator=generator, dtype=torch.float64) - 0.5
    x = 1.1 * place * torch.tensor(SUV.size_m, dtype=torch.float64)
    return x[F64(x).abs().argsort()[:400]]


def rounding_m(x_object: Tensor) -> Tensor:
    """Bound (N,) the change of the metric distance by float32: the rounding of the place, and that of the decoder."""
    x_sdf = x_object @ (F64.sdf_R_object.T / SUV.scale_m) + F64.sdf_t_object
    held = x_sdf.float().double()
    # The product with scale_m is one rounding more.
    return (
        SUV.scale_m * (input_rounding(DOUBLE, x_sdf) + decoder_rounding(DOUBLE, held, CODE)) + U32 * F64(x_object).abs()
    )


def test_the_field(near_surface: Tensor) -> None:
    change = (F32(near_surface).double() - F64(near_surface)).abs()
    bound = rounding_m(near_surface)
    assert bool((change <= bound).all()) and float((change / bound).max()) > EMPTY


def test_linear_regions(near_surface: Tensor) -> None:
    """The value's bound on a beam is the field's own; the slope has the same sums with slopes as terms.

    No derivative is larger than the product of spectral norms. The field's bound holds for sums of places and biases of
    order one, so it also holds for the slope's sums of unit directions, unless a unit is about to switch.
    """
    direction = torch.nn.functional.normalize(torch.randn(400, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    one, exact = F32.region(near_surface, direction.double()), F64.region(near_surface, direction.double())
    bound = rounding_m(near_surface)
    # tanh flattens: the value before it has a larger error, by the factor 1 / (1 - g^2).
    steeper = 1 / (1 - (F64(near_surface) / SUV.scale_m).square())
    assert bool(((one.value - exact.value).abs() <= bound * steeper + U32 * exact.value.abs()).all())
    # A unit whose switch is within the rounding of the place may belong to either region.
    configured = exact.length > 100 * bound
    change = (one.slope - exact.slope).abs()[configured & (one.length > 100 * bound)]
    same = change <= float(bound.max()) / SUV.scale_m
    assert same.double().mean() > 0.9
    assert float(change.median()) > 0


def test_what_float32_reaches_is_what_the_api_says(near_surface: Tensor) -> None:
    """Brackets are shrunk until nothing is left between their ends, which gives roots at float32's limit.

    No root is guaranteed to be better than the API's statement, and none is worse. The statement is not loose: the
    worst root reaches a tenth of it.
    """
    stated = reachable_residual_m(torch.float32, SUV.scale_m)
    residual = _true_residual(F32, near_surface)
    assert 0.1 * stated < float(residual.max()) <= stated
    # Some roots are better by luck, not by orders of magnitude.
    assert float(residual.median()) > 0.01 * stated


def test_what_float64_reaches(near_surface: Tensor) -> None:
    """No better reference exists: the test uses the field's own value at the two ends of the last bracket."""
    stated = reachable_residual_m(torch.float64, SUV.scale_m, range_m=1.0)
    residual = _true_residual(F64, near_surface)
    assert 0.01 * stated < float(residual.max()) <= stated


def _true_residual(field: ObjectField, near_surface: Tensor) -> Tensor:
    """Return |g| (M,) in float64 at roots of `field`, by bisection from 1 m outside along the field's gradient."""
    leaf = near_surface.clone().requires_grad_()
    (normal,) = torch.autograd.grad(F64(leaf).sum(), leaf)
    direction = -torch.nn.functional.normalize(normal, dim=1)
    outer, inner = torch.full((len(leaf),), -0.15, dtype=torch.float64), torch.full((len(leaf),), 0.15).double()

    def at(k: Tensor) -> Tensor:
        return near_surface + k[:, None] * direction

    with torch.no_grad():
        kept = (F64(at(outer)) > 0) & (F64(at(inner)) < 0)
        for _ in range(55):
            middle = 0.5 * (outer + inner)
            negative = field(at(middle)) < 0
            outer, inner = torch.where(negative, outer, middle), torch.where(negative, middle, inner)
        assert kept.sum() > 200
        return F64(at(0.5 * (outer + inner)))[kept].abs()


def test_the_decoders_own_sums_add_no_more_than_the_statement_gives_them(near_surface: Tensor) -> None:
    """Two thirds of the statement cover these sums: 2 u in sdf units. Measured at places that float32 holds exactly."""
    held = (near_surface @ (F64.sdf_R_object.T / SUV.scale_m) + F64.sdf_t_object).float()
    change = (SINGLE(held).double() - DOUBLE(held.double())).abs()
    assert EMPTY * U32 < float(change.max()) < 2 * U32
    assert bool((change <= decoder_rounding(DOUBLE, held.double(), CODE)).all())


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_preset_asks_for_what_it_can_reach(name: str) -> None:
    """Vehicles may be up to 20 m long. Float32 reaches the paper's 1e-6, because places are relative to the object."""
    settings = preset(name)
    assert settings.tolerance_m >= settings.reachable_residual_m(scale_m=5.0 if name == "paper" else 10.0)


def test_a_tolerance_below_is_refused_with_a_remedy() -> None:
    standard = preset("standard")
    with pytest.raises(InputError, match=r"1e-08 m cannot be reached in float32.*tolerance_m=.* or dtype=float64"):
        standard.with_(tolerance_m=1e-8)
    with pytest.raises(InputError, match="float64"):
        preset("reference").with_(tolerance_m=1e-16)
    with pytest.raises(InputError, match="cannot be reached in bfloat16"):
        standard.with_(dtype=torch.bfloat16)
    # For this vehicle's known scale: 1e-7 m is reachable for a toy of a metre.
    fine = standard.with_(tolerance_m=1e-7)
    beams = Beams.from_arrays(np.array([[30.0, 0.0, 0.0]]), np.zeros(3))
    with pytest.raises(InputError, match="1e-07 m cannot be reached"):
        render(beams, SINGLE, torch.tensor([14.0, 0, 0, 0, 0, 0]).double(), SUV, fine)


def test_the_published_setting_stays_usable() -> None:
    """A solver that bisects a fixed number of times ignores the tolerance, which may have any value."""
    assert preset("paper").with_(tolerance_m=1e-12).tolerance_m == 1e-12


@pytest.mark.parametrize("distance_m", [15.0, 80.0])
def test_the_paper_reaches_its_1e_6_in_float32_near_and_far(distance_m: float) -> None:
    theta = torch.tensor([distance_m, 0.0, 0.0, 0.4, 0.0, 0.0], dtype=torch.float64)
    rng = np.random.default_rng(0)
    ends = np.array([distance_m, 0.0, 0.0]) + rng.uniform(-0.5, 0.5, (12, 3))
    beams = Beams.from_arrays(ends * (distance_m + 6.0) / distance_m, np.zeros(3))
    drawn = render(beams, SINGLE, theta, SUV, preset("paper").with_(sphere_chord_only=True))
    assert drawn.object_points == 12 and drawn.max_residual_m < 1e-6
    # Checked in float64 as well: float32's evaluation of its own root would not show the error.
    x_object = drawn.points - theta[:3]
    yaw = torch.tensor([[math.cos(0.4), -math.sin(0.4), 0], [math.sin(0.4), math.cos(0.4), 0], [0, 0, 1]]).double()
    assert float(F64(x_object @ yaw).abs().max()) < 1e-6


def test_reachable_at_the_asked_tolerance(near_surface: Tensor) -> None:
    """Every root settles, to within tolerance plus rounding, if float32 can just reach the tolerance."""
    settings = RenderSettings(tolerance_m=reachable_residual_m(torch.float32, SUV.scale_m), final_newton_m=0.0)
    theta = torch.tensor([14.0, 0.0, 0.0, 0.4, 0.0, 0.0], dtype=torch.float64)
    rng = np.random.default_rng(1)
    ends = np.array([14.0, 0.0, 0.0]) + rng.uniform(-0.6, 0.6, (60, 3))
    drawn = render(Beams.from_arrays(ends * 1.5, np.zeros(3)), SINGLE, theta, SUV, settings)
    assert drawn.unresolved_beams == 0 and drawn.object_points > 50
    assert drawn.max_residual_m <= settings.tolerance_m
