"""The Chamfer distance against cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from shift3d.sdf.meshes import distance_to_surface, symmetric_chamfer
from shift3d.seeding import generator


def square(side: float, z: float) -> trimesh.Trimesh:
    """Return a square sheet about the z axis."""
    h = side / 2
    corners = [[-h, -h, z], [h, -h, z], [h, h, z], [-h, h, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def test_distance_to_the_surface_is_not_to_its_vertices() -> None:
    points = np.array([[0.0, 0.0, 0.5], [2.0, 0.0, 0.0], [0.3, 0.1, 0.0]])
    assert distance_to_surface(points, square(2.0, 0.0)) == pytest.approx([0.5, 1.0, 0.0])


def test_parallel_sheets_are_their_gap_apart() -> None:
    assert symmetric_chamfer(square(2.0, 0.0), square(2.0, 0.25), generator("c"), 500) == pytest.approx(0.25)


def test_it_is_half_the_sum_of_both_directions() -> None:
    """The small sheet has distance 0 from the large one in its plane; back it is the mean distance to the small square.

    For the square [-1, 1]^2 and the inner [-1/2, 1/2]^2 it is, by quadrant, with u, v = the excess over 1/2: (2 *
    integral of u over [0, 1/2] x [0, 1/2] + integral of hypot(u, v) over [0, 1/2]^2) / 1.
    """
    strips = 2 * 0.5**2 / 2 * 0.5
    corner = 0.5**3 * (np.sqrt(2) + np.arcsinh(1.0)) / 3
    expected = (0.0 + strips + corner) / 2
    found = symmetric_chamfer(square(1.0, 0.0), square(2.0, 0.0), generator("d"), 40_000)
    assert found == pytest.approx(expected, rel=0.02)


def test_it_does_not_depend_on_the_order_and_vanishes_on_itself() -> None:
    box, ball = trimesh.creation.box((1, 1, 1)), trimesh.creation.icosphere(subdivisions=3)
    assert symmetric_chamfer(box, box, generator("e"), 1000) == pytest.approx(0.0, abs=1e-9)
    there, back = (symmetric_chamfer(a, b, generator("e"), 20_000) for a, b in ((box, ball), (ball, box)))
    assert there == pytest.approx(back, rel=0.02)
