"""A fit recovers known shapes, depends on nothing else, and states its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from known_shapes import LENGTH_M, PER_LENGTH, SCALE_M, coordinates, subspace, surface_points, towards

from shift3d.retrieval.fit import Fit, fit_shape, turned

NOTHING = np.zeros((0, 3))


def fitted(points: np.ndarray, free: np.ndarray = NOTHING, **more: float) -> Fit:
    return fit_shape(subspace(), points, free, LENGTH_M, PER_LENGTH, **more)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_complete_points_without_noise_give_the_code_back(seed: int) -> None:
    u = 0.8 * coordinates(seed)
    found = fitted(surface_points(u), noise_m=2e-4)
    assert np.abs(found.u - u).max() < 0.03
    assert found.scale_m == pytest.approx(SCALE_M, rel=1e-3) and np.abs(found.shift_m).max() < 2e-3
    assert abs(found.turn_rad) < 1e-3 and found.residual_m < 1e-3 and found.outliers == 0.0


def test_a_box_that_is_a_little_off_is_put_right() -> None:
    u, shift, turn = 0.7 * coordinates(4), np.array([0.06, -0.04, 0.03]), 0.02
    found = fitted(turned(surface_points(u), turn) + shift, noise_m=2e-4)
    assert np.abs(found.shift_m - shift).max() < 4e-3 and found.turn_rad == pytest.approx(turn, abs=2e-3)
    assert np.abs(found.u - u).max() < 0.05


def test_a_few_wrong_points_change_little() -> None:
    u = 0.8 * coordinates(5)
    points = surface_points(u)
    wrong = np.concatenate((points, np.random.default_rng(0).uniform(-0.4, 0.4, (15, 3))))
    off = np.linalg.norm(fitted(wrong).u - fitted(points).u)
    assert off < 0.35 and 0.0 < fitted(wrong).outliers < 0.06


def test_the_same_points_give_the_same_bytes_whatever_was_fitted_between() -> None:
    points = surface_points(coordinates(6), 120)
    first = fitted(points)
    fitted(surface_points(coordinates(7), 40))
    again = fitted(points)
    assert first.u.tobytes() == again.u.tobytes() and first.scale_m == again.scale_m


def test_what_was_not_seen_stays_uncertain_and_more_points_say_more() -> None:
    u = coordinates(8)
    points = surface_points(u)
    from_behind = towards(points, np.array([-20.0, 0.0, 0.5]), u)
    every, rear, none = fitted(points), fitted(from_behind), fitted(from_behind[:1])
    spreads = [float(np.linalg.norm(found.uncertainty)) for found in (every, rear, none)]
    assert spreads[0] < spreads[1] < spreads[2] < np.sqrt(10)
    assert np.linalg.norm(none.u) < 1.5


def test_no_place_that_beams_passed_through_lies_deep_inside() -> None:
    """The rear points are the same and few; beams that passed over a low car's bonnet and boot bound its roof."""
    u = coordinates(9)
    points = towards(surface_points(u), np.array([-20.0, 0.0, 0.5]), u)[:25]
    before = fitted(points)
    above = np.array([(x, y, z) for x in (-1.2, 0.0, 0.9) for y in (-0.4, 0.0, 0.4) for z in (0.35, 0.45)])
    after = fitted(points, above)

    def deepest(found: Fit) -> float:
        with torch.no_grad():
            places = torch.from_numpy((above - found.shift_m) / found.scale_m).float()
            return float(subspace().field(found.u)(places).min()) * found.scale_m

    assert deepest(before) < -0.1
    assert deepest(after) > deepest(before) / 2


def test_hopeless_points_give_finite_numbers() -> None:
    for points in (np.zeros((30, 3)), np.full((12, 3), 2.0), np.random.default_rng(0).uniform(-2, 2, (50, 3))):
        found = fitted(points)
        assert np.isfinite([*found.u, *found.shift_m, found.turn_rad, found.scale_m, *found.uncertainty]).all()
        assert np.linalg.norm(found.u) <= subspace().radius * (1 + 1e-9)
