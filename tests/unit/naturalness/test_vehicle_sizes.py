"""Sizes in metres: measures of boxes, and sizes that no data sheet has."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from vehicles_by_hand import box, on_legs

from shift3d.naturalness.sizes import published_ranges, sizes_of
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.vehicles.family.wide import build_wide_mesh, wide_vehicle


@pytest.mark.parametrize("clearance_m", [0.1, 0.2, 0.35])
def test_the_clearance_is_that_of_the_body_between_the_wheels(clearance_m: float) -> None:
    assert sizes_of(surface_of_mesh(on_legs(clearance_m))).clearance_m == pytest.approx(clearance_m, abs=1e-6)


def test_a_symmetric_shape_is_its_own_mirror_image() -> None:
    assert sizes_of(surface_of_mesh(box())).asymmetry_cm < 0.5


def test_what_stands_on_one_side_alone_is_asymmetric() -> None:
    """A block of 1 x 0.4 x 0.4 m is on the roof's left edge: its own surface is missing on the right."""
    block = trimesh.creation.box((1.0, 0.4, 0.4))
    block.apply_translation((0, 0.7, 0.95))
    found = sizes_of(surface_of_mesh(trimesh.util.concatenate([box(), block])))
    assert found.asymmetry_cm > 0.8
    mirrored = trimesh.util.concatenate([box(), block])
    mirrored.apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    assert sizes_of(surface_of_mesh(mirrored)).asymmetry_cm == pytest.approx(found.asymmetry_cm, abs=0.15)


def test_vehicles_have_sizes_of_vehicles() -> None:
    names = published_ranges()
    assert {"length_m", "width_m", "height_m", "width_to_length", "height_to_length"} <= set(names)
    for index in range(0, 40, 5):
        assert sizes_of(surface_of_mesh(build_wide_mesh(wide_vehicle(index, 3), 0.08))).out_of_range() == ()


@pytest.mark.parametrize(
    ("size", "wrong"),
    [
        ((4.5, 0.9, 1.4), {"width_m"}),  # a limousine squeezed to the length of a car
        ((0.045, 0.018, 0.015), {"length_m", "width_m", "height_m"}),  # another unit
        ((4.5, 1.8, 0.8), {"height_m"}),
        ((2.5, 1.7, 1.5), {"length_m", "width_to_length", "height_to_length"}),
        ((12.0, 2.3, 3.0), {"length_m"}),
    ],
)
def test_sizes_that_no_vehicle_has_are_named(size: tuple[float, float, float], wrong: set[str]) -> None:
    vehicle = on_legs(0.2)
    vehicle.apply_scale(np.array(size) / np.asarray(vehicle.extents))
    found = set(sizes_of(surface_of_mesh(vehicle)).out_of_range()) - {"clearance_m"}
    assert wrong <= found


def test_a_surface_without_length_is_out_of_range_and_no_division_by_zero() -> None:
    wall = trimesh.Trimesh([[0, 0, 0], [0, 1.8, 0], [0, 1.8, 1.5], [0, 0, 1.5]], [[0, 1, 2], [0, 2, 3]], process=False)
    assert {"length_m", "width_to_length"} <= set(sizes_of(surface_of_mesh(wall)).out_of_range())
