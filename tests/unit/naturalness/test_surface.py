"""Surfaces as points: known distances of boxes, and changes that must not affect them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from vehicles_by_hand import box

from shift3d.errors import InputError
from shift3d.naturalness.surface import POINTS, Surface, surface_of_mesh, surface_of_points
from shift3d.sdf.meshes import distance_to_surface
from shift3d.vehicles.family.wide import build_wide_mesh, wide_vehicle


def apart_cm(a: Surface, b: Surface) -> float:
    return 50.0 * float(a.distances_to(b.points).mean() + b.distances_to(a.points).mean())


@pytest.mark.parametrize("metres", [0.02, 0.06, 0.1])
def test_a_longer_box_is_as_far_as_its_ends(metres: float) -> None:
    """Both ends are half the difference away, and the far parts of the longer box's sides half of that on average."""
    short, long = box(), box(4.5 + metres)
    ends, length = 2 * 1.8 * 1.5, 2 * (1.8 + 1.5)
    out = (ends * metres / 2 + length * metres * metres / 4) / long.area
    back = ends * metres / 2 / short.area
    a, b = surface_of_mesh(short), surface_of_mesh(long)
    # Discs reach beyond an edge by their radius: a point less than that outside counts as on the surface.
    bound = length * metres * min(metres / 2, a.disc_m) / long.area
    assert out - bound - 2e-4 <= a.distances_to(b.points).mean() <= out + 2e-4
    assert b.distances_to(a.points).mean() == pytest.approx(back, abs=2e-3)


def test_the_same_surface_is_at_distance_zero_and_another_triangulation_nearly() -> None:
    mesh = box()
    assert apart_cm(surface_of_mesh(mesh), surface_of_mesh(mesh)) == pytest.approx(0.0, abs=1e-9)
    finer = mesh.subdivide().subdivide().subdivide()
    assert apart_cm(surface_of_mesh(mesh), surface_of_mesh(finer)) < 0.35


def test_distances_are_those_to_triangles_to_two_millimetres_or_three_percent() -> None:
    """The plain reference computes exact distances to the triangles of vehicles of the family."""
    meshes = [build_wide_mesh(wide_vehicle(index, 3), 0.08) for index in (0, 5, 8, 12)]
    for first, second in zip(meshes, meshes[1:] + meshes[:1]):
        a, b = surface_of_mesh(first), surface_of_mesh(second)
        placed = second.copy()
        low, high = np.asarray(second.bounds)
        placed.apply_translation(-np.array([*(low + high)[:2] / 2, low[2]]))
        exact = distance_to_surface(a.points, placed)
        found = b.distances_to(a.points)
        assert found.mean() == pytest.approx(exact.mean(), abs=2e-3, rel=0.03)
        assert np.quantile(found, 0.95) == pytest.approx(np.quantile(exact, 0.95), abs=1e-2, rel=0.03)


def test_a_vehicle_is_the_same_wherever_it_stands() -> None:
    moved = box()
    moved.apply_translation((12.0, -3.0, 0.7))
    here, there = surface_of_mesh(box()), surface_of_mesh(moved)
    np.testing.assert_allclose(here.points, there.points, atol=1e-9)
    assert here.points[:, 2].min() >= 0.0 and here.size_m == pytest.approx((4.5, 1.8, 1.5))


def test_a_higher_box_differs_at_its_top_not_at_the_ground() -> None:
    low, high = surface_of_mesh(box()), surface_of_mesh(box(height=1.7))
    apart = low.distances_to(high.points)
    top = high.points[:, 2] > 1.699
    assert apart[top].mean() == pytest.approx(0.2, abs=1e-3)
    assert apart[high.points[:, 2] < 1e-6].mean() == pytest.approx(0.0, abs=1e-3)


def test_the_order_of_triangles_and_of_points_changes_nothing() -> None:
    mesh = build_wide_mesh(wide_vehicle(1, 3), 0.08)
    order = np.random.default_rng(0).permutation(len(mesh.faces))
    shuffled = trimesh.Trimesh(mesh.vertices, mesh.faces[order], process=False)
    one, other = surface_of_mesh(mesh), surface_of_mesh(shuffled)
    np.testing.assert_array_equal(one.points, other.points)
    points = one.points[np.random.default_rng(1).permutation(POINTS)]
    np.testing.assert_allclose(surface_of_points(points).points, surface_of_points(one.points).points, atol=1e-12)


def test_points_of_a_surface_stand_for_it() -> None:
    mesh = build_wide_mesh(wide_vehicle(1, 3), 0.08)
    of_mesh = surface_of_mesh(mesh)
    of_points = surface_of_points(trimesh.sample.sample_surface_even(mesh, 6000, seed=0)[0])
    assert apart_cm(of_mesh, of_points) < 0.6
    assert of_points.size_m == pytest.approx(of_mesh.size_m, abs=0.05)


def test_every_part_has_points_in_proportion_to_its_area() -> None:
    surface = surface_of_mesh(box())
    share = 2 * 1.8 * 1.5 / box().area
    assert (np.abs(surface.points[:, 0]) > 2.2499).mean() == pytest.approx(share, abs=1e-3)
    assert (np.abs(surface.points[::4, 0]) > 2.2499).mean() == pytest.approx(share, abs=4e-3)


@pytest.mark.parametrize(
    "vertices", [np.zeros((3, 3)), np.full((3, 3), np.nan), np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]])]
)
def test_what_is_no_surface_is_refused(vertices: np.ndarray) -> None:
    with pytest.raises(InputError, match="surface"):
        surface_of_mesh(trimesh.Trimesh(vertices, [[0, 1, 2]], process=False))


@pytest.mark.parametrize("points", [np.zeros((50, 3)), np.zeros((200, 2)), np.full((200, 3), np.inf)])
def test_what_are_no_points_of_a_surface_is_refused(points: np.ndarray) -> None:
    with pytest.raises(InputError, match="Give \\(N, 3\\)"):
        surface_of_points(points)
