"""The embedded vehicles, measured on their meshes, against published dimensions of production models."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from decoded_baselines import decoded_baseline
from mesh_dimensions import Dimensions, measure

from shift3d.errors import InputError
from shift3d.vehicles.family import BODY_TYPES, RANGES, build_mesh, family
from shift3d.vehicles.family.published import (
    CLEARANCE_TOLERANCE_M,
    PUBLISHED,
    QUANTITIES,
    published_range,
    tyre_diameter_m,
)
from shift3d.vehicles.family.spec import VehicleSpec
from shift3d.vehicles.vehicle import baseline_vehicles, family_seed, family_vehicles

ROUNDING_M = 0.005  # published values are rounded to a centimetre
MEASURED = 9  # vehicles of the shipped family that are built and measured: one of each body type


def _box_on_wheels() -> trimesh.Trimesh:
    """Return a box 4 x 1.8 x 1 m, floor 0.2 m up, on four wheels of radius 0.3 m with axles at x = 1.2 and -1.4."""
    parts = [trimesh.creation.box((4.0, 1.8, 1.0), trimesh.transformations.translation_matrix((0, 0, 0.7)))]
    upright = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    for x in (1.2, -1.4):
        for y in (-0.8, 0.8):
            wheel = trimesh.creation.cylinder(0.3, 0.2, sections=256, transform=upright)
            wheel.apply_translation((x, y, 0.3))
            parts.append(wheel)
    return trimesh.util.concatenate(parts)


def _stated(spec: VehicleSpec) -> Dimensions:
    """Return the dimensions that a vehicle was built with."""
    return Dimensions(
        spec.length_m, spec.width_m, spec.height_m, spec.wheelbase_m, spec.clearance_m, 2.0 * spec.wheel_radius_m
    )


def test_a_box_on_wheels_measures_what_it_was_built_with() -> None:
    mesh = _box_on_wheels()
    mesh.apply_translation((3.0, -1.0, 0.4))  # its place does not matter
    found = measure(mesh)
    assert (found.length_m, found.width_m, found.height_m) == pytest.approx((4.0, 1.8, 1.2), abs=1e-6)
    assert found.wheelbase_m == pytest.approx(2.6, abs=0.002)
    assert found.clearance_m == pytest.approx(0.2, abs=1e-6)
    assert found.tyre_diameter_m == pytest.approx(0.6, abs=0.002)


def test_what_has_no_wheels_is_refused() -> None:
    with pytest.raises(InputError, match="wheel"):
        measure(trimesh.creation.box((4.0, 1.8, 1.0)))


def test_tyre_sizes() -> None:
    assert tyre_diameter_m("205/55 R16") == pytest.approx(2 * 0.11275 + 0.4064)
    with pytest.raises(ValueError, match="P205"):
        tyre_diameter_m("P205/55R16")


@pytest.mark.parametrize("body_type", BODY_TYPES)
def test_every_vehicle_that_can_be_drawn_is_within_published_dimensions(body_type: str) -> None:
    assert len({model.name for model in PUBLISHED[body_type]}) >= 11
    ranges = RANGES[body_type]
    for quantity in QUANTITIES:
        radius = ranges["wheel_radius_m"]
        low, high = (2 * radius[0], 2 * radius[1]) if quantity == "tyre_diameter_m" else ranges[quantity]
        least, most = published_range(body_type, quantity)
        assert least - ROUNDING_M <= low <= high <= most + ROUNDING_M, quantity


def test_built_meshes_measure_what_they_state_and_are_within_published_dimensions() -> None:
    for spec in family(MEASURED, family_seed()):
        found, stated = measure(build_mesh(spec, resolution_m=0.04)), _stated(spec)
        for quantity in QUANTITIES:
            value = getattr(found, quantity)
            assert value == pytest.approx(getattr(stated, quantity), abs=0.006), f"{spec.body_type}: {quantity}"
            least, most = published_range(spec.body_type, quantity)
            assert least - ROUNDING_M <= value <= most + ROUNDING_M, f"{spec.body_type}: {quantity} {value:.3f}"


def test_the_shipped_family_is_typical() -> None:
    specs = family(len(family_vehicles()), family_seed())
    for body_type in BODY_TYPES:
        stated = [_stated(spec) for spec in specs if spec.body_type == body_type]
        for quantity in QUANTITIES:
            median = np.median([getattr(dimensions, quantity) for dimensions in stated])
            found = (getattr(model, quantity) for model in PUBLISHED[body_type])
            low, high = np.quantile([value for value in found if value is not None], (0.1, 0.9))
            give = ROUNDING_M + CLEARANCE_TOLERANCE_M * (quantity == "clearance_m")
            assert low - give <= median <= high + give, f"{body_type}: {quantity} {median:.3f}"


def test_baselines_keep_published_dimensions_when_decoded() -> None:
    for name in baseline_vehicles():
        found = measure(decoded_baseline(name))
        for quantity in QUANTITIES:
            least, most = published_range(name, quantity)
            value = getattr(found, quantity)
            assert least - ROUNDING_M <= value <= most + ROUNDING_M, f"{name}: {quantity} {value:.3f}"
