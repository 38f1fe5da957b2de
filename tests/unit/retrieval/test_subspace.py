"""The folded subspace equals the decoder, and its derivatives are those of its values."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from known_shapes import coordinates, subspace

from shift3d.errors import InputError
from shift3d.retrieval.subspace import Subspace
from shift3d.vehicles.sources import VehicleSet


def places(count: int = 200) -> torch.Tensor:
    rng = torch.Generator().manual_seed(1)
    return torch.rand(count, 3, generator=rng) - 0.5


@pytest.mark.parametrize("seed", [0, 1])
def test_its_field_is_that_of_its_code(seed: int) -> None:
    u = subspace().project(coordinates(seed))
    decoder = VehicleSet().decoder()
    with torch.no_grad():
        whole = decoder.field(torch.from_numpy(subspace().code(u)))(places())
    # A tenth of a millimetre on a car.
    assert float((subspace().field(u)(places()) - whole).abs().max()) < 4e-5


def test_derivatives_are_those_of_finite_differences() -> None:
    u, x, step = coordinates(2), places(60), 2e-3
    _, at_point, by_u = subspace().linearized(u, x)
    for axis in range(subspace().components):
        ahead, behind = (subspace().field(u + sign * step * np.eye(10)[axis])(x) for sign in (1, -1))
        # The median: the decoder is piecewise linear, and a step may cross into another piece.
        assert float(((ahead - behind) / (2 * step) - by_u[:, axis]).abs().median()) < 2e-4
    moved = subspace().field(u)(x + torch.tensor([step, 0.0, 0.0])) - subspace().field(u)(x)
    assert float((moved / step - at_point[:, 0]).abs().median()) < 5e-3


def test_coordinates_stay_within_the_ellipsoid() -> None:
    far = 100.0 * coordinates(3)
    back = subspace().project(far)
    assert np.linalg.norm(back) == pytest.approx(subspace().radius)
    assert np.allclose(back / np.linalg.norm(back), far / np.linalg.norm(far))
    assert np.array_equal(subspace().project(0.1 * back), 0.1 * back)


def test_too_few_codes_are_refused() -> None:
    vehicles = VehicleSet()
    with pytest.raises(InputError, match="11 codes: too few for 10 components"):
        Subspace.of(vehicles.decoder(), vehicles.codes()[:11])
