"""Surfaces of analytic fields."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from shift3d.errors import InputError
from shift3d.sdf.meshes import extract_mesh, field_on_grid


def ball(radius: float):
    return lambda x: x.norm(dim=1) - radius


def thin_sheet(x: torch.Tensor) -> torch.Tensor:
    """Return a slab of half thickness 0.012: far thinner than the first grid's cells."""
    q = x.abs() - torch.tensor([0.6, 0.012, 0.5])
    return q.clamp(min=0).norm(dim=1) + q.max(dim=1).values.clamp(max=0)


def test_ball_is_closed_outward_and_of_the_right_size() -> None:
    mesh = extract_mesh(ball(0.6), 65)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.6**3, rel=5e-3)
    assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(0.6, abs=2e-3)


def test_skipping_far_nodes_changes_nothing_near_the_surface_and_loses_no_thin_part() -> None:
    values, step = field_on_grid(thin_sheet, 129)
    axis = torch.linspace(-1, 1, values.shape[0])
    full = thin_sheet(torch.cartesian_prod(axis, axis, axis)).numpy().reshape(values.shape)
    near = np.abs(full) < step
    assert near.any()
    assert values[near] == pytest.approx(full[near], abs=1e-6)
    assert np.array_equal(values < 0, full < 0)


def test_a_field_without_a_surface_says_so() -> None:
    with pytest.raises(InputError, match="no surface"):
        extract_mesh(lambda x: x.norm(dim=1) + 1.0, 33)


def test_pieces_are_kept() -> None:
    centres = torch.tensor([[0.4, 0.0, 0.0], [-0.5, 0.0, 0.0]])

    def two(x: torch.Tensor) -> torch.Tensor:
        return torch.minimum((x - centres[0]).norm(dim=1) - 0.4, (x - centres[1]).norm(dim=1) - 0.2)

    assert extract_mesh(two, 65).body_count == 2
