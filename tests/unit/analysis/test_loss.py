"""The gate's test against closed forms and simulated releases, and its power against counting."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from shift3d.analysis.statistics.loss import (
    detectable_loss,
    flip_p_values,
    objects_needed,
    recall_power,
    scene_sums,
)
from shift3d.analysis.statistics.releases import ReleaseRule, measured_differences, stopped_releases


@pytest.mark.parametrize(("lost", "gained"), [(1, 0), (6, 0), (5, 2), (0, 4), (40, 25)])
def test_one_object_a_scene_and_one_measure_is_mcnemars_exact_test(lost: int, gained: int) -> None:
    sums = np.concatenate((-np.ones(lost), np.ones(gained)))[:, None]
    exact = binom.sf(lost - 1, lost + gained, 0.5)
    assert flip_p_values(sums)[0] == pytest.approx(exact, abs=1e-12 if lost + gained <= 13 else 0.01)


def test_objects_of_one_scene_count_once() -> None:
    """Ten objects lost in one scene are one event; each in a scene of its own, they are ten events."""
    differences = -np.ones((10, 1))
    assert flip_p_values(scene_sums(differences, ["a"] * 10))[0] == 0.5
    assert flip_p_values(scene_sums(differences, list("abcdefghij")))[0] == 2.0**-10
    both = scene_sums(np.array([[1.0], [-1.0], [2.0]]), ["a", "a", "b"])
    assert both.tolist() == [[2.0]], "a scene whose changes cancel says nothing"


def test_p_values_are_corrected_for_the_measures_and_unchanged_ones_are_one() -> None:
    rng = np.random.default_rng(0)
    sums = rng.standard_normal((40, 3)) - [0.5, 0.0, 0.0]
    alone = flip_p_values(sums[:, :1])[0]
    together = flip_p_values(sums)
    assert alone < together[0] <= 3 * alone + 0.01 and together[0] == together.min()
    # A duplicate measure costs no significance, and neither does a measure without a change.
    assert flip_p_values(sums[:, [0, 0]])[0] == alone
    assert flip_p_values(np.c_[sums[:, :1], np.zeros(40)]).tolist() == [alone, 1.0]
    assert flip_p_values(np.zeros((0, 2))).tolist() == [1.0, 1.0]
    assert flip_p_values(-sums[:, :1])[0] == pytest.approx(1.0 - alone, abs=0.02)


def test_many_tests_at_once_are_each_of_them() -> None:
    sums = np.random.default_rng(1).standard_normal((30, 5, 2))
    assert np.array_equal(flip_p_values(sums), [flip_p_values(sums[:, i]) for i in range(5)])


def test_differences_are_of_each_groups_own_objects() -> None:
    before, after = np.array([0.4, 0.2, 0.9]), np.array([0.2, 0.4, 0.8])
    hard = np.array([True, False, True])
    found = measured_differences(before, after, [hard, ~hard], 0.3)
    assert found == pytest.approx(np.array([[-1, -0.2, 0, 0], [0, 0, 1, 0.2], [0, -0.1, 0, 0]]))


def test_power_is_that_of_counting() -> None:
    # Without churn a loss is found if enough objects are lost for 2^-b to be significant.
    assert recall_power(500, 0.02, 0.0, 0.025) == pytest.approx(binom.sf(5, 500, 0.02), abs=1e-9)
    rng = np.random.default_rng(2)
    drawn = rng.multinomial(300, [0.06, 0.02, 0.92], 4000)
    found = binom.sf(drawn[:, 0] - 1, drawn[:, :2].sum(axis=1), 0.5) <= 0.025
    assert recall_power(300, 0.06, 0.02, 0.025) == pytest.approx(found.mean(), abs=0.025)


def test_the_objects_needed_have_the_power_and_grow_with_churn() -> None:
    needed = [objects_needed(0.02, churn, 0.9, 0.025) for churn in (0.0, 0.01, 0.05)]
    assert None not in needed and sorted(set(needed)) == needed  # type: ignore[type-var]
    for churn, number in zip((0.0, 0.01, 0.05), needed):
        assert recall_power(number or 0, churn + 0.02, churn, 0.025) >= 0.9
        assert recall_power(round(0.9 * (number or 0)), churn + 0.02, churn, 0.025) < 0.9
        assert detectable_loss(number or 0, churn, 0.9, 0.025) == pytest.approx(0.02, abs=0.001)
    assert detectable_loss(4, 0.0, 0.9, 0.025) is None
    assert objects_needed(1e-5, 0.3, 0.9, 0.025) is None


def suite(objects: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return scores of hard objects and of controls, two of each per scene."""
    rng = np.random.default_rng(3)
    logits = np.concatenate((rng.normal(-0.5, 2.0, objects), rng.normal(2.0, 1.2, objects)))
    places = [str(index % objects // 2) for index in range(2 * objects)]
    return 1.0 / (1.0 + np.exp(-logits)), np.repeat([True, False], objects), places


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
def test_of_200_releases_a_loss_of_two_points_is_found_in_nine_of_ten(noise: float) -> None:
    """The gate finds the loss of 500 hard objects in at least 90 %, and stops at most 5 % without a loss."""
    rates = stopped_releases(*suite(500), noise, 0.02, ReleaseRule(), releases=200)
    assert rates.found is not None and rates.found >= 0.90
    assert rates.false_alarms <= 0.05
    assert (rates.lost > 0) == (noise > 0)


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_noisy_trainings_are_not_stopped_more_often(noise: float) -> None:
    """The rate stays the same for any noise, although objects of a scene share half of the noise."""
    scores, hard, places = suite(240)
    strict = ReleaseRule(level=0.05, tolerance=0.0)
    rates = stopped_releases(scores, hard, places, noise, 0.02, strict, releases=400)
    assert rates.false_alarms <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)


def test_a_loss_below_the_tolerance_stops_nothing() -> None:
    rule = ReleaseRule(tolerance=0.005)
    changes, p_values = np.array([-0.004, -0.005, -0.2, 0.1]), np.array([0.001, 0.001, 0.06, 0.001])
    assert rule.stops(changes, p_values).tolist() == [False, True, False, False]
    assert stopped_releases(*suite(20), 0.0, 0.9, rule).found is None, "too few are detected to lose nine of ten"
    scores, hard, places = suite(20)
    none_seen = stopped_releases(np.where(hard, 0.01, scores), hard, places, 0.0, 0.02, rule)
    assert none_seen.found is None, "two points of twenty objects are one object at least"
