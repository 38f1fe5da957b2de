"""Whether a shape is still a car: one piece, sides and volume near the baseline's, and halves that match."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from shift3d.vehicles.outline import ONE_PIECE, SIDES, VOLUMES, Outline, outline, volume_m3
from shift3d.vehicles.vehicle import Vehicle

SIZE = (4.4, 1.8, 1.5)
SCALE_M = 2.5
VEHICLE = Vehicle("box", "suv", np.zeros(4, np.float32), SCALE_M, np.eye(3), np.zeros(3), SIZE)


class Boxes:
    """A decoder of boxes: (centre, size) each, metres, whatever the code."""

    def __init__(self, *boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> None:
        self.boxes = boxes

    def field(self, code: Tensor) -> Callable[[Tensor], Tensor]:
        def distance(points: Tensor) -> Tensor:
            found = []
            for centre, size in self.boxes:
                beyond = (points * SCALE_M - torch.tensor(centre)).abs() - torch.tensor(size) / 2
                found.append(beyond.clamp(min=0).norm(dim=-1) + beyond.amax(-1).clamp(max=0))
            return torch.stack(found).amin(0) / SCALE_M

        return distance


def look(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Outline:
    decoder: Any = Boxes(*boxes)
    return outline(VEHICLE, decoder, np.zeros(4, np.float32), float(np.prod(SIZE)))


def test_the_baseline_is_a_car_of_its_own_size() -> None:
    found = look(((0, 0, 0), SIZE))
    assert found.still_a_car and found.largest_piece == pytest.approx(1.0)
    assert found.size_m == pytest.approx(SIZE, abs=0.03) and found.sides == pytest.approx((1, 1, 1), abs=0.02)
    assert found.volume == pytest.approx(1.0, abs=0.02) and found.mirrored == 1.0
    decoder: Any = Boxes(((0, 0, 0), SIZE))
    assert volume_m3(VEHICLE, decoder) == pytest.approx(np.prod(SIZE), rel=0.02)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("factor", "car"), [(0.70, False), (0.85, True), (1.30, True), (1.45, False)])
def test_a_side_far_from_the_baselines_is_no_cars(axis: int, factor: float, car: bool) -> None:
    assert SIDES == (0.75, 1.35)
    size = list(SIZE)
    size[axis] *= factor
    if size[0] > 4.6:  # the decoder's sphere ends here: everything smaller in its place
        return
    assert look(((0, 0, 0), (size[0], size[1], size[2]))).still_a_car is car


def test_a_crumb_is_forgiven_and_a_second_half_is_not() -> None:
    crumb = look(((0, 0, 0), SIZE), ((0, 0, 1.2), (0.35, 0.35, 0.35)))
    assert ONE_PIECE <= crumb.largest_piece < 1.0
    halves = look(((-1.2, 0, 0), (2.0, 1.8, 1.5)), ((1.2, 0, 0), (2.0, 1.8, 1.5)))
    assert halves.largest_piece == pytest.approx(0.5, abs=0.01) and not halves.still_a_car
    assert halves.sides == pytest.approx((1, 1, 1), abs=0.02)  # its outer size alone would pass


def test_a_car_that_has_lost_half_of_its_volume_is_none_though_its_sides_are_whole() -> None:
    floor, post = ((0.0, 0.0, -0.6), (4.4, 1.8, 0.3)), ((0.0, 0.0, 0.1), (0.8, 0.8, 1.3))
    found = look(floor, post)
    assert found.sides == pytest.approx((1, 1, 1), abs=0.03) and found.largest_piece == pytest.approx(1.0)
    assert found.volume == pytest.approx((4.4 * 1.8 * 0.3 + 0.64 * 1.2) / np.prod(SIZE), abs=0.03)
    assert found.mirrored > 0.99 and not found.still_a_car


def test_a_car_that_has_lost_a_flank_is_none_though_its_volume_is_near() -> None:
    """Its left half is lower by a third: of the right half's upper part nothing lies opposite."""
    left, right = ((0.0, 0.45, -0.25), (4.4, 0.9, 1.0)), ((0.0, -0.45, 0.0), (4.4, 0.9, 1.5))
    found = look(left, right)
    assert found.sides == pytest.approx((1, 1, 1), abs=0.03)
    assert found.volume == pytest.approx(2.5 / 3.0, abs=0.02) and VOLUMES[0] < found.volume
    assert found.mirrored == pytest.approx(2.0 / 2.5, abs=0.03) and not found.still_a_car


def test_the_middle_plane_is_the_shapes_own() -> None:
    """A car that was moved to the side mirrors as it did."""
    assert look(((0, 0.3, 0), SIZE)).mirrored == pytest.approx(1.0, abs=0.01)


def test_a_code_without_a_surface_is_no_car() -> None:
    found = look(((9, 9, 9), (0.1, 0.1, 0.1)))
    assert found.size_m is None and not found.still_a_car
