"""Whether a shape is still a car: one piece, and sides near the baseline's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from shift3d.vehicles.outline import ONE_PIECE, SIDES, Outline, outline
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
    return outline(VEHICLE, Boxes(*boxes), np.zeros(4, np.float32))  # type: ignore[arg-type]


def test_the_baseline_is_a_car_of_its_own_size() -> None:
    found = look(((0, 0, 0), SIZE))
    assert found.still_a_car and found.largest_piece == pytest.approx(1.0)
    assert found.size_m == pytest.approx(SIZE, abs=0.03) and found.sides == pytest.approx((1, 1, 1), abs=0.02)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("factor", "car"), [(0.70, False), (0.80, True), (1.30, True), (1.45, False)])
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


def test_a_code_without_a_surface_is_no_car() -> None:
    found = look(((9, 9, 9), (0.1, 0.1, 0.1)))
    assert found.size_m is None and not found.still_a_car
