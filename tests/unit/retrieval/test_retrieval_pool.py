"""The nearest of a pool, the paper's rule, and controls that were seen alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.retrieval.pool import POINTS_RATIO, RANGE_RATIO, Pool, excluded


def table(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    usual = {"status": "fitted", "flags": [], "latent_code": [0.0, 0.0], "range_m": 20.0, "points": 100}
    full = [usual | row for row in rows]
    return {name: [row[name] for row in full] for name in full[0]}


def test_the_nearest_is_the_nearest_of_what_may_be_retrieved() -> None:
    rows = [
        {"latent_code": [1.0, 0.0]},
        {"latent_code": [0.1, 0.0], "flags": ["one_side"]},
        {"latent_code": None, "status": "few_points"},
        {"latent_code": [0.0, 2.0]},
    ]
    pool = Pool.of(table(rows), "pool")
    assert len(pool.rows) == 2
    assert pool.nearest(np.array([0.2, 0.0])) == (0, pytest.approx(0.8))
    assert pool.nearest(np.array([0.0, 1.7])) == (1, pytest.approx(0.3))
    twice = Pool.of(table([{"latent_code": [1.0, 0.0]}] * 3), "pool")
    assert twice.nearest(np.array([0.0, 0.0]))[0] == 0


def test_a_pool_without_usable_vehicles_is_refused() -> None:
    with pytest.raises(InputError, match="no vehicle could be fitted"):
        Pool.of(table([{"status": "few_points"}, {"flags": ["wrong_box"]}]), "pool")


def test_the_papers_rule() -> None:
    code = np.array([3.0, 4.0])
    assert not excluded(code, 4.999) and excluded(code, 5.0) and excluded(code, float("nan"))


def test_controls_were_seen_from_as_far_and_by_as_many_points() -> None:
    rng = np.random.default_rng(0)
    rows = [
        {"range_m": float(r), "points": int(p)} for r, p in zip(rng.uniform(5, 60, 999), rng.integers(10, 900, 999))
    ]
    pool = Pool.of(table(rows), "pool")
    found = pool.controls(7, 5)
    assert 2 <= len(found) <= 5 and 7 not in found
    for index in found:
        ratio = pool.range_m[index] / pool.range_m[7], pool.points[index] / pool.points[7]
        assert 1 / RANGE_RATIO <= ratio[0] <= RANGE_RATIO and 1 / POINTS_RATIO <= ratio[1] <= POINTS_RATIO
    lonely = Pool.of(table([{"range_m": 5.0}, {"range_m": 50.0}, {"points": 10}]), "pool")
    assert lonely.controls(0, 3) == []


def test_a_control_may_have_half_as_many_points_again_or_be_what_has() -> None:
    pool = Pool.of(table([{"points": 30}, {"points": 45}, {"points": 20}, {"points": 46}, {"points": 19}]), "pool")
    assert sorted(pool.controls(0, 5)) == [1, 2]
    assert 0 in pool.controls(1, 5) and 0 in pool.controls(2, 5)
