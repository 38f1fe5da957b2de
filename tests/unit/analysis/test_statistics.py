"""Means, bands and corrections over scenes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pandas as pd
import pytest
from scipy.stats import bootstrap

from shift3d.analysis.html.sections.curves import thresholds
from shift3d.analysis.statistics.intervals import Interval, mean_interval, recall_band, vehicle_mean_interval
from shift3d.analysis.statistics.paired import holm, paired
from shift3d.evaluation.recall_curve import area_under, recall_curve
from shift3d.seeding import generator


def test_a_vehicle_with_more_scores_weighs_no_more_in_the_mean() -> None:
    rows = pd.DataFrame(
        {"score": [0.9, 0.9, 0.9, 0.1], "vehicle": ["suv"] * 3 + ["coupe"], "place": ["a", "b", "c", "a"]}
    )
    assert vehicle_mean_interval(rows).mean == pytest.approx(0.5)


def test_vehicles_in_few_scenes_do_not_widen_the_interval_of_the_mean() -> None:
    """The mean of every draw is a mean of the vehicles' means, too."""
    alike = pd.DataFrame({"score": 0.5, "vehicle": ["suv"] * 10 + ["coupe"], "place": [*map(str, range(10)), "0"]})
    assert vehicle_mean_interval(alike) == Interval(0.5, 0.5, 0.5)
    rng = np.random.default_rng(0)
    rows = pd.DataFrame(
        [
            {"vehicle": name, "place": f"{scene:02d}", "score": float(np.clip(0.8 + rng.normal(0, 0.05), 0, 1))}
            for scene in range(20)
            for name in "abcde"
            if name != "e" or scene < 4
        ]
    )
    found = vehicle_mean_interval(rows)
    assert 0.75 < found.low < found.mean < found.high < 0.85
    even = rows[rows["vehicle"] != "e"]
    plain = mean_interval(even["score"], list(even["place"]))
    assert vehicle_mean_interval(even).low == pytest.approx(plain.low, abs=1e-12), "a balanced table is no other"


def test_vehicles_that_have_one_score_everywhere_have_an_interval() -> None:
    """The mean is the same without any scene, so that BCa would divide by 0."""
    saturated = {"suv": 0.0, "coupe": 1.0}
    scenes = {f"{scene:02d}": tuple(saturated) for scene in range(10)} | {"10": ("suv",)}

    def rows(scenes: dict[str, tuple[str, ...]]) -> pd.DataFrame:
        return pd.DataFrame(
            [{"score": saturated[name], "vehicle": name, "place": at} for at, names in scenes.items() for name in names]
        )

    assert vehicle_mean_interval(rows(scenes)) == Interval(0.5, 0.5, 0.5)
    # Of three scenes every 27th draw holds the first alone, as many the second: more than BCa's 2.5 % at either end.
    assert vehicle_mean_interval(rows({"a": ("suv",), "b": ("coupe",), "c": ("suv", "coupe")})) == Interval(0.5, 0, 1)


@pytest.mark.parametrize("tenths", [(1, 7, 3), (3, 2, 1), (1, 2, 3, 4), (1, 6, 1, 1, 3)])
def test_the_interval_of_few_scenes_does_not_depend_on_rounding(tenths: tuple[int, ...]) -> None:
    """Sums of whole numbers are exact. Sums of tenths differ by rounding if the scenes are drawn in another order."""
    places = [str(at) for at in range(len(tenths))]
    exact, found = (mean_interval(np.divide(tenths, by), places) for by in (1, 10))
    assert (found.low, found.high) == pytest.approx((exact.low / 10, exact.high / 10))
    vehicles = ["suv"] * len(tenths) + ["coupe"] * len(tenths)
    table = pd.DataFrame({"score": np.array(tenths + tenths[::-1]), "vehicle": vehicles, "place": places * 2})
    exact, found = (vehicle_mean_interval(table.assign(score=table["score"] / by)) for by in (1, 10))
    assert (found.low, found.high) == pytest.approx((exact.low / 10, exact.high / 10))


def test_an_interval_over_thousands_of_scenes_takes_a_hundred_megabytes() -> None:
    scenes = 2_000
    score = np.random.default_rng(0).uniform(size=5 * scenes)
    rows = pd.DataFrame({"score": score, "vehicle": list("abcde") * scenes, "place": np.repeat(np.arange(scenes), 5)})
    tracemalloc.start()
    try:
        found = vehicle_mean_interval(rows)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # With equally many scores per vehicle the mean is that of all scores, whose interval scipy computes at once.
    scene_means = score.reshape(scenes, 5).mean(axis=1)
    rng = generator("bootstrap", len(rows), scenes)
    whole = bootstrap((scene_means,), np.mean, n_resamples=4_000, rng=rng).confidence_interval
    assert (found.low, found.high) == pytest.approx((whole.low, whole.high), abs=1e-9)
    assert peak < 100e6


def test_bands_hold_their_curve_and_its_area_is_the_mean_score() -> None:
    rng = np.random.default_rng(0)
    scores, places = rng.beta(2, 1, size=300), [f"scene-{i // 6}" for i in range(300)]
    recall, low, high = recall_band(scores, places, thresholds())
    assert low is not None and high is not None
    assert (low <= recall).all() and (recall <= high).all()
    assert (high - low)[50:150].min() > 0.02
    assert recall == pytest.approx([(scores > t).mean() for t in thresholds()], abs=1e-12)
    assert area_under(recall_curve(scores)) == pytest.approx(scores.mean(), abs=1e-9)
    assert recall_band(scores[:6], places[:6], thresholds())[1] is None
    again = recall_band(scores, places, thresholds())[1]
    assert again is not None and (again == low).all()


def test_a_band_covers_the_truth_about_as_often_as_it_says() -> None:
    rng, at, held = np.random.default_rng(2), np.array([0.5]), 0
    for _ in range(200):
        _, low, high = recall_band(rng.random(80), [str(i) for i in range(80)], at)
        assert low is not None and high is not None
        held += bool(low[0] <= 0.5 <= high[0])
    assert 0.88 <= held / 200 <= 0.99


def test_differences_that_are_equal_but_for_rounding_tie_in_the_signed_rank_test() -> None:
    """Differences of sixteenths are exact. Differences of tenths, such as 0.9 - 0.7 and 0.3 - 0.1, are not."""
    ours, theirs = np.array([9, 3, 4, 1, 8, 2, 6, 7]), np.array([7, 1, 6, 4, 5, 3, 5, 4])
    places = [str(at) for at in range(len(ours))]

    def p_value(by: int) -> float | None:
        parts = {"adversarial": ours / by, "random": theirs / by}
        tables = [
            pd.DataFrame({"task_id": places, "place": places, "method": name, "score": part})
            for name, part in parts.items()
        ]
        found = paired(pd.concat(tables), "adversarial", "random")
        return found.p_value if found else None

    assert p_value(10) == p_value(16)


def test_holm_steps_down() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == [pytest.approx(0.03), pytest.approx(0.06), None, pytest.approx(0.06)]
    assert holm([]) == [] and holm([0.9, 0.8]) == [1.0, 1.0]
