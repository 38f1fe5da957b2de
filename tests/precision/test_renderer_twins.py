"""Roots, solvers, gradients at the surface and constraints in float32 against float64.

Two runs have roots of |g| <= tol each, in fields that differ by E (the effect of rounding on g, see `rounding`). Their
roots are at most (2 tol + E) / |dg/dk| apart, where dg/dk is the smaller of the slopes at both: across a kink between
them the slope is no smaller than that if the field has few pieces there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, in_frame, soft_car
from rounding import EMPTY, LAMBDA, U32, decoder_rounding, gamma, input_rounding
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene, scene_R_object
from shift3d.placement.constraints import PAPER_CONSTRAINTS, check
from shift3d.render import Beams, Rendering, RenderSettings, preset, render
from shift3d.render.beams import FirstHits
from shift3d.render.field.object_field import ObjectField
from shift3d.render.implicit import surface_points
from shift3d.render.solvers.roots import find_roots
from shift3d.sdf.decoder import load_decoder
from shift3d.vehicles.vehicle import baseline_vehicles

SUV = baseline_vehicles()["suv"]
CODE = torch.from_numpy(SUV.latent_code)
SINGLE, DOUBLE = load_decoder().field(CODE), load_decoder().double().field(CODE.double())
THETA = torch.tensor([14.0, 1.0, 0.0, 0.6, 0.02, -0.03], dtype=torch.float64)


def test_roots() -> None:
    """Float32 rounds three products and three sums of the cubic: E = gamma(7) sum |c_i| |k|^i."""
    generator = torch.Generator().manual_seed(0)
    root = 0.2 * torch.rand(500, generator=generator) - 0.1
    rise = 0.2 + torch.rand(500, generator=generator)
    # g = -(k - root) (rise + k^2): one root, slope at most -0.2 there; as sums of powers.
    powers = torch.stack((root * rise, -rise, root, -torch.ones(500)), 1)
    tolerance = 1e-7  # about float32's limit, so that its rounding shows

    def cubic(coefficients: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
        def g(k: Tensor, rows: Tensor) -> Tensor:
            c, x = coefficients[rows], k.to(coefficients.dtype)
            return ((c[:, 3] * x + c[:, 2]) * x + c[:, 1]) * x + c[:, 0]

        return g

    found = []
    every = torch.arange(500)
    for coefficients in (powers, powers.double()):
        ends = torch.full((500,), -0.3, dtype=torch.float64), torch.full((500,), 0.3, dtype=torch.float64)
        g = cubic(coefficients)
        found.append(find_roots(g, *ends, g(ends[0], every).double(), g(ends[1], every).double(), tolerance, 60))
    single, double = found
    assert single.converged.all() and double.converged.all()
    k = double.k.abs()
    size = (powers.double().abs() * torch.stack((k**0, k, k**2, k**3), 1)).sum(1)
    bound = (2 * tolerance + gamma(7) * size) / 0.2
    change = (single.k - double.k).abs()
    assert bool((change <= bound).all()) and float((change / bound).max()) > EMPTY


@dataclass(frozen=True)
class Solver:
    """Settings, the accuracy of their roots as values (|g|, m), and as places (m)."""

    settings: RenderSettings
    value_m: float
    place_m: float = 0.0


_PLAIN = preset("standard").with_(final_newton_m=0.0)
SOLVERS = {
    "sphere_tracing": Solver(_PLAIN, _PLAIN.tolerance_m),
    # A root is a quotient: its accuracy is that of the two numbers.
    "piecewise_linear": Solver(preset("reference").with_(tolerance_m=1e-5, box_margin_m=0.05), 0.0),
    "plain_sphere_tracing": Solver(_PLAIN.with_(solver="plain_sphere_tracing"), _PLAIN.tolerance_m),
    # Thirty halvings of a step.
    "paper": Solver(preset("paper").with_(sphere_chord_only=True), 0.0, 0.1 / 2**30),
}


def fan_at_the_vehicle(count: int = 40) -> Beams:
    rng = np.random.default_rng(0)
    ends = THETA[:3].numpy() + rng.uniform(-1.0, 1.0, (count, 3)) * [0.9, 0.9, 0.55]
    return Beams.from_arrays(ends * 1.5, np.zeros(3))


def slopes_and_rounding(drawn: Rendering, beams: Beams, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return |dg/dk| at some hits, in float64, and the bound of g's change by float32 there; metric."""
    place = (beams.origins + drawn.range_m[:, None] * beams.directions)[rows]
    x_object = object_from_scene(place, THETA)
    x_sdf = x_object @ torch.from_numpy(SUV.sdf_R_object).T / SUV.scale_m + torch.from_numpy(SUV.sdf_t_object)
    leaf = x_sdf.requires_grad_()
    (gradient,) = torch.autograd.grad(DOUBLE(leaf).sum(), leaf)
    along = beams.directions[rows] @ scene_R_object(THETA) @ torch.from_numpy(SUV.sdf_R_object).T
    error = input_rounding(DOUBLE, leaf) + decoder_rounding(DOUBLE, leaf.detach().float().double(), CODE)
    return (gradient * along).sum(-1).abs(), SUV.scale_m * error


@pytest.mark.parametrize("name", list(SOLVERS))
def test_solvers(name: str) -> None:
    solver, beams = SOLVERS[name], fan_at_the_vehicle(20 if name == "paper" else 40)
    single = render(beams, SINGLE, THETA, SUV, solver.settings.with_(dtype=torch.float32))
    double = render(beams, DOUBLE, THETA, SUV, solver.settings.with_(dtype=torch.float64))
    assert torch.equal(single.hit_mask, double.hit_mask) and single.object_points >= 15
    slope_1, error = slopes_and_rounding(single, beams, single.hit_mask)
    slope_2, _ = slopes_and_rounding(double, beams, double.hit_mask)
    bound = 2 * solver.place_m + (2 * solver.value_m + error) / torch.minimum(slope_1, slope_2)
    change = (single.range_m - double.range_m)[single.hit_mask].abs()
    assert bool((change <= bound).all()) and float((change / bound).max()) > EMPTY
    # The residual that a rendering states is that of its field, which float64 confirms within rounding.
    assert single.max_residual_m <= max(solver.value_m, float(error.max()) + solver.place_m)


def test_gradients_at_the_surface() -> None:
    """dL/dpose and dL/dcode at the same hits, of a smooth shape whose formula takes some 60 operations.

    dg/dv and dg/dk are off by d = gamma(60) times the sizes of their terms, below 4 (arms of 2.5 m, normals of 1.5). A
    range's derivative, -(dg/dv) / (dg/dk), is off by (1 / slope + |dg/dv| / slope^2) d; a point's coordinates by that
    times their share of the beam, which the loss weighs by a cosine.
    """
    settings = preset("standard").with_(dtype=torch.float64, final_newton_m=0.0)
    beams = fan_at_the_vehicle(60)
    code = torch.tensor([0.3, -0.2, 0.1, 0.5, -0.4, 0.8], dtype=torch.float64)
    field = in_frame(soft_car(code), SHAPENET_FRAME)
    found = render(beams, field, THETA, SHAPENET_FRAME, settings)
    rows = torch.nonzero(found.hit_mask).squeeze(1)
    nothing = torch.empty(0, dtype=torch.long)
    hits = FirstHits(rows, found.range_m[rows], torch.zeros(len(rows), dtype=torch.float64), nothing)
    gradients, least = [], 1.0
    for dtype in (torch.float32, torch.float64):
        z, theta = code.clone().requires_grad_(), THETA.clone().requires_grad_()
        metric = ObjectField.of(in_frame(soft_car(z), SHAPENET_FRAME), SHAPENET_FRAME, dtype, 4096)
        points, _, share, _ = surface_points(beams, hits, metric, theta, settings.min_n_dot_d)
        assert torch.equal(points, beams.origins[rows] + hits.range_m[:, None] * beams.directions[rows])
        gradients.append(torch.cat(torch.autograd.grad(points.sin().sum(), (z, theta))))
        least = max(share.least_slope, settings.min_n_dot_d)
    assert len(rows) > 15
    weight = (found.points[rows].cos() * beams.directions[rows]).sum(-1).abs()
    bound = float(weight.sum()) * 4.0 * gamma(60) * (1 / least + 4.0 / least**2)
    change = float((gradients[0] - gradients[1]).abs().max())
    assert EMPTY * bound < change < bound


def test_constraints() -> None:
    """Deepest and nearest original point are values of the field: their error is the field's rounding error."""
    generator = torch.Generator().manual_seed(0)
    offset = (torch.rand(300, 3, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor([5.0, 2.2, 2.0])
    points = offset @ scene_R_object(THETA).T + THETA[:3]
    size = torch.tensor(SUV.size_m, dtype=torch.float64)
    answers = []
    for field, dtype in ((SINGLE, torch.float32), (DOUBLE, torch.float64)):
        metric = ObjectField.of(field, SUV, dtype, 4096)
        answers.append(check(metric, points, THETA, size, 500, PAPER_CONSTRAINTS))
    x_sdf = offset @ torch.from_numpy(SUV.sdf_R_object).T / SUV.scale_m + torch.from_numpy(SUV.sdf_t_object)
    error = input_rounding(DOUBLE, x_sdf) + decoder_rounding(DOUBLE, x_sdf.float().double(), CODE)
    bound = SUV.scale_m * float(error.max()) + LAMBDA * U32
    single, double = answers
    for name in ("deepest_m", "nearest_m"):
        assert abs(getattr(single, name) - getattr(double, name)) <= bound
    assert single.deepest_m != double.deepest_m
    assert (single.overlap_ok, single.contact_ok, single.points_ok) == (double.overlap_ok, double.contact_ok, True)
