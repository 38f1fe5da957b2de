"""A coarse lattice of a field: exact where the field is linear, and honest about what it cannot tell."""

import torch
from torch import Tensor

from shift3d.render.bounding_box import Box
from shift3d.render.sdf_grid import SPACING_M, FieldLattice

BOX = Box(torch.tensor([-2.1, -0.9, -0.7], dtype=torch.float64), torch.tensor([2.0, 1.0, 0.8], dtype=torch.float64))
WIDER = BOX.grown(0.5)


def linear(x: Tensor) -> Tensor:
    return 0.3 * x[:, 0] - 0.5 * x[:, 1] + 0.2 * x[:, 2] + 0.1


def places(count: int = 500) -> Tensor:
    share = torch.rand(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return BOX.lower + share * (BOX.upper - BOX.lower)


def test_a_linear_field_is_told_to_rounding_and_the_box_is_inside() -> None:
    lattice = FieldLattice.of(linear, BOX)
    assert float((lattice.at(places()) - linear(places())).abs().max()) < 2e-6
    last = (lattice.first + torch.tensor(lattice.g.shape) - 1).double() * SPACING_M
    assert (lattice.first.double() * SPACING_M <= BOX.lower + 1e-9).all() and (last >= BOX.upper - 1e-9).all()


def test_a_wider_box_leaves_the_points_and_so_the_estimates_where_they_were() -> None:
    def wavy(x: Tensor) -> Tensor:
        return torch.sin(5.0 * x).sum(-1)

    narrow, wide = FieldLattice.of(wavy, BOX), FieldLattice.of(wavy, WIDER)
    assert float((narrow.at(places()) - wide.at(places())).abs().max()) < 2e-6


def test_outside_the_nearest_place_inside_counts() -> None:
    lattice = FieldLattice.of(linear, BOX)
    far = torch.tensor([[50.0, 0.1, 0.2]], dtype=torch.float64)
    at_face = far.clone()
    at_face[0, 0] = float((lattice.first[0] + lattice.g.shape[0] - 1) * SPACING_M)
    assert float((lattice.at(far) - lattice.at(at_face)).abs()) < 2e-6


def test_a_change_that_is_the_same_everywhere_is_even_and_a_slope_is_not() -> None:
    before = FieldLattice.of(linear, BOX)
    lifted = FieldLattice.of(lambda x: linear(x) + 0.2, WIDER)
    inside = places() * 0.8  # not in a cell that the narrow lattice has no point of
    assert float(lifted.unevenness(before, inside).max()) < 1e-5
    tilted = FieldLattice.of(lambda x: linear(x) + 0.1 * x[:, 0], BOX)
    spread = tilted.unevenness(before, places())
    assert float((spread - 0.1 * SPACING_M).abs().max()) < 1e-5


def test_a_field_that_is_no_number_somewhere_is_no_number_around_it_alone() -> None:
    hole = torch.tensor([0.0, 0.0, 0.0], dtype=torch.float64)
    lattice = FieldLattice.of(lambda x: torch.where((x - hole).norm(dim=-1) < 0.1, torch.nan, linear(x)), BOX)
    near = (places() - hole).abs().amax(-1) < SPACING_M
    assert near.any() and torch.equal(torch.isnan(lattice.at(places())), near)
