"""Mean reduction of the score by 10 m cell."""

from __future__ import annotations

import numpy as np
import pytest

from shift3d.evaluation.bev_grid import bev_grid


def test_by_hand() -> None:
    xy = [(15.0, 0.0), (19.9, 9.9), (20.0, 0.0), (-0.1, -10.0)]
    grid = bev_grid(xy, before=[0.9, 0.7, 0.8, 0.5], after=[0.3, 0.3, 0.8, 0.6])
    assert grid.corner_xy_m.tolist() == [[-10.0, -10.0], [10.0, 0.0], [20.0, 0.0]]
    assert grid.count.tolist() == [1, 2, 1]
    assert grid.mean_before == pytest.approx([0.5, 0.8, 0.8])
    assert grid.mean_after == pytest.approx([0.6, 0.3, 0.8])
    assert grid.mean_reduction == pytest.approx([-0.1, 0.5, 0.0])


def test_cells_add_up_to_the_whole() -> None:
    rng = np.random.default_rng(0)
    before, after = rng.uniform(size=(2, 200))
    grid = bev_grid(rng.uniform(-50, 50, size=(200, 2)), before, after)
    assert grid.count.sum() == 200
    assert (grid.count * grid.mean_reduction).sum() == pytest.approx((before - after).sum())


def test_no_vehicle_is_no_cell() -> None:
    assert bev_grid(np.zeros((0, 2)), [], []).count.size == 0


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match="positions"):
        bev_grid([(0.0, 0.0)], [1.0, 2.0], [1.0])
