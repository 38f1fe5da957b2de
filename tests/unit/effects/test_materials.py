"""Places on a vehicle of 4 x 1.8 x 1.5 m, computed by hand from the shares in `materials`.

Bottom at z = -0.75. Windows from z = (0.62 - 0.5) 1.5 = 0.18 to 0.63. Axles at x = 1.24 and -1.12; tyre radius 0.3,
centre at z = -0.45, rim radius 0.186; tyres beyond |y| = 0.6. Edges reach 2 cm to either side.
"""

import math

import pytest
import torch
from analytic_fields import Frame

from shift3d.effects.physics.materials import (
    DARKEST_ALBEDO,
    EDGE_M,
    GLASS_ALBEDO,
    PAINT_ALBEDO,
    TYRE_ALBEDO,
    albedo_of,
)
from shift3d.geometry.se3 import scene_from_object

CAR = Frame(size_m=(4.0, 1.8, 1.5))
AT_ORIGIN = torch.zeros(6, dtype=torch.float64)
TURNED = torch.tensor([20.0, -7.0, 0.4, 2.1, 0.05, -0.08], dtype=torch.float64)


def albedo(*place: float) -> float:
    return float(albedo_of(torch.tensor([place], dtype=torch.float64), AT_ORIGIN, CAR))


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((0.0, 0.9, 0.0), PAINT_ALBEDO),  # door
        ((2.0, 0.0, -0.2), PAINT_ALBEDO),  # front
        ((0.0, 0.0, 0.75), PAINT_ALBEDO),  # roof
        ((0.5, 0.0, -0.55), PAINT_ALBEDO),  # underbody
        ((0.0, 0.8, 0.4), GLASS_ALBEDO),  # side window
        ((0.9, 0.0, 0.3), GLASS_ALBEDO),  # windscreen
        ((1.24, 0.85, -0.7), TYRE_ALBEDO),  # front left, 0.25 below its axle
        ((1.24, -0.85, -0.7), TYRE_ALBEDO),
        ((-1.12, 0.85, -0.7), TYRE_ALBEDO),  # rear left
        ((-1.12, -0.85, -0.7), TYRE_ALBEDO),
        ((-1.12 + 0.24, 0.85, -0.45), TYRE_ALBEDO),  # beside its axle, at its height
        ((1.24, 0.85, -0.45), PAINT_ALBEDO),  # hub: rim
        ((1.24, 0.85, -0.1), PAINT_ALBEDO),  # fender above the tyre, 0.35 from the axle
        ((1.24, 0.0, -0.7), PAINT_ALBEDO),  # between the wheels
        ((0.0, 0.9, 0.18), 0.5 * (PAINT_ALBEDO + GLASS_ALBEDO)),  # on the belt line
        ((0.0, 0.9, 0.17), 0.75 * PAINT_ALBEDO + 0.25 * GLASS_ALBEDO),  # 1 cm below it: a quarter of the edge left
        ((0.0, 0.9, 0.63), 0.5 * (PAINT_ALBEDO + GLASS_ALBEDO)),
        ((1.24, 0.6, -0.7), 0.5 * (PAINT_ALBEDO + TYRE_ALBEDO)),  # inner side of the tyre
    ],
)
def test_places_worked_out_by_hand(place, expected):
    assert albedo(*place) == pytest.approx(expected, abs=1e-12)


def test_the_object_frame_decides_wherever_the_vehicle_stands():
    place = 2.0 * torch.rand(500, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) - 1.0
    place = place * torch.tensor(CAR.size_m, dtype=torch.float64) / 2
    here, there = albedo_of(place, AT_ORIGIN, CAR), albedo_of(scene_from_object(place, TURNED), TURNED, CAR)
    assert torch.allclose(here, there, rtol=0, atol=1e-12)


def test_between_the_darkest_and_paint_and_constant():
    place = torch.randn(20_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)).requires_grad_()
    values = albedo_of(place, TURNED.clone().requires_grad_(), CAR)
    assert values.dtype == torch.float64 and not values.requires_grad
    assert bool(((values >= DARKEST_ALBEDO) & (values <= PAINT_ALBEDO)).all())
    assert DARKEST_ALBEDO == TYRE_ALBEDO


def test_rounding_changes_it_by_no_more_than_rounding():
    """The slope is at most paint over edge in each of at most four factors."""
    place = torch.rand(50_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3)) * 3.0 - 1.5
    moved = place.float().double()
    shift = (place - moved).norm(dim=-1)
    change = (albedo_of(place, AT_ORIGIN, CAR) - albedo_of(moved, AT_ORIGIN, CAR)).abs()
    assert bool((change <= 4.0 * PAINT_ALBEDO / EDGE_M * shift + 1e-15).all())
    assert float(change.max()) < 1e-5


def test_tyres_of_a_longer_vehicle_are_where_its_axles_are():
    longer = Frame(size_m=(5.0, 2.0, 1.7))  # axles at 1.55 and -1.4, radius 0.375, bottom at -0.85
    place = torch.tensor([[1.55, 0.95, -0.8], [-1.4, -0.95, -0.8], [1.24, 0.95, -0.8]], dtype=torch.float64)
    front, rear, between = albedo_of(place, AT_ORIGIN, longer).tolist()
    assert (front, rear) == (TYRE_ALBEDO, TYRE_ALBEDO)
    # (-0.31, -0.325) from that axle, outside the tyre.
    assert math.hypot(0.31, 0.325) > 0.375 + EDGE_M and between == PAINT_ALBEDO


def test_a_pose_that_is_not_finite_stays_visible():
    broken = torch.full((6,), math.nan, dtype=torch.float64)
    assert bool(albedo_of(torch.zeros(3, 3), broken, CAR).isnan().all())


def test_no_points():
    assert albedo_of(torch.zeros(0, 3), AT_ORIGIN, CAR).shape == (0,)
