"""The percentile: share of left-out members that are nearer than a shape."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shift3d.naturalness.calibration import MIN_MEMBERS, NATURAL_PERCENTILE, Calibration

values = st.lists(st.floats(0.0, 100.0), min_size=20, max_size=60)


def test_the_percentile_is_the_share_of_members_that_lie_nearer() -> None:
    both = Calibration(np.arange(1.0, 101.0), np.arange(1.0, 101.0))
    assert both.percentile(0.5, 0.5) == 0.0
    assert both.percentile(50.5, 50.5) == 50.0
    assert both.percentile(1e9, 1e9) == 100.0


def test_a_share_of_whole_per_cent_is_that_number_so_that_a_budget_of_it_holds() -> None:
    both = Calibration(np.arange(1.0, 401.0), np.arange(1.0, 401.0))
    assert [both.percentile(4 * share + 0.5, 0.0) for share in range(101)] == list(range(101))


def test_the_worse_of_mean_and_tail_counts() -> None:
    both = Calibration(np.arange(1.0, 101.0), np.arange(1.0, 101.0))
    assert both.percentile(0.5, 90.5) == both.percentile(90.5, 0.5) == 90.0


@given(values, st.randoms())
def test_by_chance_as_many_members_lie_within_a_percentile_as_it_says(means: list[float], random: object) -> None:
    """Ranks of the members themselves are even: at most the stated share is above, for any means and tails."""
    tails = list(means)
    random.shuffle(tails)  # type: ignore[attr-defined]
    found = Calibration(np.array(means), np.array(tails))
    own = np.array([found.percentile(mean, tail) for mean, tail in zip(means, tails)])
    assert (own <= NATURAL_PERCENTILE).mean() >= NATURAL_PERCENTILE / 100.0
    assert own.min() == 0.0


@given(values, st.floats(0, 100), st.floats(0, 100))
def test_farther_is_never_more_natural(means: list[float], near: float, more: float) -> None:
    found = Calibration(np.array(means), np.array(means)[::-1])
    assert found.percentile(near, 1.0) <= found.percentile(near + more, 1.0)
    assert found.percentile(1.0, near) <= found.percentile(1.0, near + more)


def test_the_order_of_members_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    means, tails = rng.uniform(1, 3, 50), rng.uniform(3, 9, 50)
    order = rng.permutation(50)
    one, other = Calibration(means, tails), Calibration(means[order], tails[order])
    assert [one.percentile(m, 5.0) for m in means] == [other.percentile(m, 5.0) for m in means]


def test_what_is_no_number_is_farther_than_all() -> None:
    assert Calibration(np.arange(20.0), np.arange(20.0)).percentile(math.nan, 0.0) == 100.0
    assert Calibration(np.arange(20.0), np.arange(20.0)).percentile(0.0, math.nan) == pytest.approx(100.0)


def test_of_the_fewest_members_the_farthest_is_not_natural() -> None:
    for members in (MIN_MEMBERS, 40, 60, 400):
        distances = np.arange(1.0, members + 1.0)
        usual = Calibration(distances, distances)
        within = sum(usual.percentile(far, far) <= NATURAL_PERCENTILE for far in distances)
        assert within < members and within == pytest.approx(0.95 * members, abs=1.0)
