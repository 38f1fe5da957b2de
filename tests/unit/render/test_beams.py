"""Beams: directions, ranges, rows without a beam."""

import numpy as np
import pytest
import torch

from shift3d.errors import InputError
from shift3d.render import Beams


def test_beam_runs_from_its_own_origin_to_the_return() -> None:
    points = np.array([[3.0, 4.0, 0.0], [1.0, 1.0, 5.0]], np.float32)
    origins = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 3.0]], np.float32)
    beams = Beams.from_arrays(points, origins)
    assert beams.ranges_m.tolist() == [5.0, 2.0]
    assert torch.allclose(beams.directions, torch.tensor([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64))
    assert torch.equal(beams.points, torch.from_numpy(points))


def test_zero_range_nan_and_inf_rows_carry_no_beam_and_no_nan() -> None:
    points = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1, 0, 0]], np.float32)
    beams = Beams.from_arrays(points, np.zeros(3))
    assert beams.carries.tolist() == [False, False, False, True]
    assert torch.isfinite(beams.directions).all() and torch.isfinite(beams.ranges_m).all()


def test_broadcast_origins_stay_one_row() -> None:
    origins = np.broadcast_to(np.array([1.0, 2.0, 3.0], np.float32), (5, 3))
    beams = Beams.from_arrays(np.ones((5, 3), np.float32) * 9, origins)
    assert beams.origins.stride(0) == 0
    assert beams.origins.shape == (5, 3)


def test_float64_coordinates_far_from_home_lose_nothing() -> None:
    far = np.array([15_600.0, -9_000.0, 30.0])
    near = Beams.from_arrays(np.array([[10.001, 2.0, -1.0]]), np.zeros(3))
    away = Beams.from_arrays(np.array([[10.001, 2.0, -1.0]]) + far, far)
    assert abs(float(near.ranges_m[0] - away.ranges_m[0])) < 1e-8


@pytest.mark.parametrize("points, origins", [((4, 2), (3,)), ((4, 3), (5, 3)), ((4, 3), (2,))])
def test_shapes_that_do_not_fit_are_refused(points: tuple[int, ...], origins: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        Beams.from_arrays(np.ones(points, np.float32), np.zeros(origins))


@pytest.mark.parametrize("dtype", [np.int64, np.int16, np.float16, np.bool_])
def test_points_whose_dtype_would_round_the_hits_are_refused(dtype: type[np.generic]) -> None:
    with pytest.raises(InputError, match=f"dtype {np.dtype(dtype).name}.*Cast them to float32"):
        Beams.from_arrays(np.full((4, 3), 9).astype(dtype), np.zeros(3))
