"""Grids of a field: exact if the field is linear, and with a valid error bound."""

import torch
from analytic_fields import SHAPENET_FRAME, box, car, ground_scan, in_frame, sphere
from straight_rays import coarse
from torch import Tensor

from shift3d.render import Beams, preset
from shift3d.render.culling import Box, rays_in_box
from shift3d.render.field.sdf_grid import COARSE_SPACING_M, SdfGrid

BOX = Box(torch.tensor([-2.1, -0.9, -0.7], dtype=torch.float64), torch.tensor([2.0, 1.0, 0.8], dtype=torch.float64))
WIDER = BOX.grown(0.5)
STANDARD = preset("standard").with_(dtype=torch.float64)
THETA = torch.tensor([9.0, 3.0, -0.98, 0.5, 0.0, 0.0], dtype=torch.float64)


def linear(x: Tensor) -> Tensor:
    return 0.3 * x[:, 0] - 0.5 * x[:, 1] + 0.2 * x[:, 2] + 0.1


def places(count: int = 500) -> Tensor:
    share = torch.rand(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return BOX.lower + share * (BOX.upper - BOX.lower)


def test_a_linear_field_is_told_to_rounding() -> None:
    grid = coarse(linear, BOX)
    assert float((grid.at(places()) - linear(places())).abs().max()) < 2e-6


def test_outside_the_nearest_place_inside_counts() -> None:
    grid = coarse(linear, BOX)
    far = torch.tensor([[50.0, 0.1, 0.2]], dtype=torch.float64)
    at_face = far.clone()
    at_face[0, 0] = BOX.upper[0]
    assert float((grid.at(far) - grid.at(at_face)).abs()) < 2e-6


def test_a_change_that_is_the_same_everywhere_is_even_and_a_slope_is_not() -> None:
    before, lifted = coarse(linear, BOX), coarse(lambda x: linear(x) + 0.2, BOX)
    assert float(lifted.of_cells(places(), lifted.variation(before)).max()) < 1e-5
    tilted = coarse(lambda x: linear(x) + 0.1 * x[:, 0], BOX)
    cell_m = float(BOX.upper[0] - BOX.lower[0]) / (tilted.distance_m.shape[0] - 1)
    spread = tilted.of_cells(places(), tilted.variation(before))
    assert cell_m <= COARSE_SPACING_M and float((spread - 0.1 * cell_m).abs().max()) < 1e-5


def test_a_field_that_is_no_number_somewhere_is_no_number_around_it_alone() -> None:
    axes = [
        torch.linspace(float(a), float(b), n)
        for a, b, n in zip(BOX.lower, BOX.upper, coarse(linear, BOX).distance_m.shape)
    ]
    hole = torch.stack([axis[2] for axis in axes]).double()
    grid = coarse(lambda x: torch.where((x - hole).norm(dim=-1) < 0.1, torch.nan, linear(x)), BOX)
    lost, near = torch.isnan(grid.at(places())), (places() - hole).abs().amax(-1) < COARSE_SPACING_M
    assert (near | ~lost).all() and (lost.any() or not near.any())


def test_what_the_grid_tells_along_a_ray_is_so() -> None:
    metric, beams = car(), Beams.from_arrays(*ground_scan(rings=64, columns=1024))
    grid = SdfGrid.of(in_frame(metric, SHAPENET_FRAME), SHAPENET_FRAME, STANDARD)
    rays = rays_in_box(beams, THETA, grid.box)
    readings = grid.along(rays)
    k = torch.arange(0.0, 6.0, 0.003, dtype=torch.float64)
    x = rays.at(rays.near_m)[:, None] + k[:, None] * rays.directions[:, None]
    g = torch.stack([metric(line) for line in x]).masked_fill(k > (rays.far_m - rays.near_m)[:, None], torch.inf)
    first = torch.where((g < 0).any(1), k[(g < 0).byte().argmax(1)], torch.inf)
    # No crossing hides between samples, and each is off by at most the error bound.
    of, at, values = readings.samples()
    assert float((values - metric(rays.at(at, of))).abs()[values < 0.09].max()) <= readings.error_m
    rows, guess, slope = readings.crossings(STANDARD.approach_slope)
    assert len(rows) > 0.6 * torch.isfinite(first).sum()
    assert torch.isfinite(first[rows]).all()
    assert (guess - rays.near_m[rows] - first[rows]).abs().median() < 0.004
    assert (slope < 0).all()
    free, least = torch.isinf(first), readings.clearance()
    assert (least[free] <= g[free].amin(1) + 1e-6).all()


def test_an_sdf_grid_measures_its_own_error() -> None:
    smooth = SdfGrid.of(in_frame(sphere(0.8), SHAPENET_FRAME), SHAPENET_FRAME, STANDARD)
    creased = SdfGrid.of(in_frame(box((0.8, 0.5, 0.4)), SHAPENET_FRAME), SHAPENET_FRAME, STANDARD)
    # Linear interpolation over h = 0.05 of a curvature 1 / 0.8: at most 3 h^2 / 8 times it, 1.2 mm; the floor is 5 mm.
    assert smooth.error_m == 0.005
    assert smooth.error_m < creased.error_m < 0.05
