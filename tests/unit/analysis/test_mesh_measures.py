"""A vehicle's measures on its mesh are those of a data sheet."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from shift3d.analysis.cases.rendered import simplified
from shift3d.analysis.html.sections.cases import change_lines, describe_changes
from shift3d.vehicles.mesh_measures import measure_mesh


def test_a_box_is_measured_in_centimetres() -> None:
    box = trimesh.creation.box((4.2, 1.8, 1.5))
    found = measure_mesh(box)
    assert (found.length_cm, found.width_cm, found.height_cm) == pytest.approx((420.0, 180.0, 150.0))
    assert found.volume_m3 == pytest.approx(4.2 * 1.8 * 1.5) and found.pieces == 1
    assert found.clearance_cm == pytest.approx(0.0, abs=1e-6)
    assert found.nose_cm == pytest.approx(150.0) and found.windshield_deg == pytest.approx(90.0)
    missing = [line[0] for line in change_lines(found, found) if "not measured" in line]
    assert missing == ["front overhang", "wheelbase", "rear overhang"], "a box has no axles"
    assert describe_changes(found, found).startswith("No measure changes")


def test_cavities_and_crumbs_are_no_pieces() -> None:
    box, hollow = trimesh.creation.box((4.2, 1.8, 1.5)), trimesh.creation.icosphere(radius=0.3)
    hollow.invert()  # like a cavity from marching cubes: its faces look inwards
    crumb = trimesh.creation.icosphere(radius=0.005).apply_translation((0, 0, 1.0))
    wheel = trimesh.creation.icosphere(radius=0.1).apply_translation((0, 0, -0.95))
    assert measure_mesh(trimesh.util.concatenate([box, hollow, crumb])).pieces == 1
    assert measure_mesh(trimesh.util.concatenate([box, hollow, crumb, wheel])).pieces == 2
    assert measure_mesh(trimesh.util.concatenate([hollow])).pieces == 1, "inside out it is still one"


def profile(lift_m: float, hood_m: float, windshield_deg: float) -> trimesh.Trimesh:
    """Return a car of 4 x 1.8 x 1.5 m by its side view: hood of 1 m, windshield, roof; a bridge on two feet."""
    roof_m = 1.0 - (1.5 - hood_m) / np.tan(np.radians(windshield_deg))
    ends = [(-2.0, -1.2), (-1.2, roof_m), (roof_m, 1.0), (1.0, 1.2), (1.2, 2.0)]
    parts = []
    for rear, front in ends:
        low = 0.0 if abs(rear + front) > 3.0 else lift_m
        tops = np.interp((rear, front), (roof_m, 1.0), (1.5, hood_m))
        side = [(rear, low), (front, low), (rear, tops[0]), (front, tops[1])]
        parts.append(trimesh.convex.convex_hull([(x, y, z) for x, z in side for y in (-0.9, 0.9)]))
    return trimesh.util.concatenate(parts)


@pytest.mark.parametrize("hood_m", [0.8, 0.95, 1.05])
def test_windshield_nose_and_clearance_are_found_and_said(hood_m: float) -> None:
    before, after = measure_mesh(profile(0.2, hood_m, 30.0)), measure_mesh(profile(0.26, hood_m, 50.0))
    assert before.windshield_deg == pytest.approx(30.0, abs=1.5)
    assert after.windshield_deg == pytest.approx(50.0, abs=2.5)
    assert before.nose_cm == pytest.approx(100 * hood_m) and before.clearance_cm == pytest.approx(20.0)
    assert before.bonnet_cm == pytest.approx(100.0, abs=3.0)
    axles = (before.front_overhang_cm, before.wheelbase_cm, before.rear_overhang_cm)
    assert axles == pytest.approx((40.0, 320.0, 40.0))
    message = describe_changes(before, after)
    assert "underside 6 cm farther from the ground" in message and "windshield 2" in message and "steeper" in message


def test_the_tail_of_a_car_is_the_nose_of_the_car_turned_round() -> None:
    car = profile(0.2, 0.9, 40.0)
    back = car.copy()
    back.vertices = back.vertices * (-1.0, -1.0, 1.0)
    ahead, behind = measure_mesh(car), measure_mesh(back)
    assert (behind.tail_cm, behind.rear_window_deg) == pytest.approx((ahead.nose_cm, ahead.windshield_deg), abs=0.5)
    assert behind.rear_overhang_cm == pytest.approx(ahead.front_overhang_cm)


def test_what_has_no_wheels_has_no_overhangs() -> None:
    """A box has none, also where its floor has no vertex but the corners."""
    box = trimesh.creation.box((4.2, 1.8, 1.5))
    for plank in (box.subdivide().subdivide(), box):
        found = measure_mesh(plank)
        assert (found.front_overhang_cm, found.wheelbase_cm, found.rear_overhang_cm) == (None, None, None)


@pytest.mark.parametrize("turn_rad", [0.0, 0.2, 0.5])
def test_axles_do_not_depend_on_where_the_vertices_of_a_coarse_tyre_lie(turn_rad: float) -> None:
    """Tyres of twelve corners. Their axles are off by less than the flat of a tyre, wherever its lowest corner is."""
    parts = [trimesh.creation.box((4.2, 1.8, 0.8), trimesh.transformations.translation_matrix((0.0, 0.0, 0.7)))]
    for x in (-1.3, 1.3):
        tyre = trimesh.creation.cylinder(0.32, 1.7, sections=12)
        tyre.apply_transform(trimesh.transformations.rotation_matrix(turn_rad, (0, 0, 1)))
        tyre.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
        tyre.apply_translation((x, 0.0, 0.32))
        parts.append(tyre)
    found = measure_mesh(trimesh.util.concatenate(parts))
    assert found.wheelbase_cm == pytest.approx(260.0, abs=1e-6)
    assert found.front_overhang_cm == pytest.approx(80.0, abs=2.0)
    assert found.rear_overhang_cm == pytest.approx(80.0, abs=2.0)


def test_a_large_mesh_is_made_small_enough_for_a_page() -> None:
    vertices, faces = simplified(trimesh.creation.icosphere(subdivisions=6))
    assert len(faces) <= 5000 and np.abs(np.linalg.norm(vertices, axis=1) - 1.0).max() < 0.02
    assert faces.max() < len(vertices)
