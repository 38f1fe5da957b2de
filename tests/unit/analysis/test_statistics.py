"""Means, bands and corrections over scenes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from shift3d.analysis.html.sections.curves import thresholds
from shift3d.analysis.statistics.intervals import recall_band, vehicle_mean_interval
from shift3d.analysis.statistics.paired import holm
from shift3d.evaluation.recall_curve import area_under, recall_curve


def test_a_vehicle_with_more_scores_weighs_no_more_in_the_mean() -> None:
    rows = pd.DataFrame(
        {"score": [0.9, 0.9, 0.9, 0.1], "vehicle": ["suv"] * 3 + ["coupe"], "place": ["a", "b", "c", "a"]}
    )
    assert vehicle_mean_interval(rows).mean == pytest.approx(0.5)


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


def test_holm_steps_down() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == [pytest.approx(0.03), pytest.approx(0.06), None, pytest.approx(0.06)]
    assert holm([]) == [] and holm([0.9, 0.8]) == [1.0, 1.0]
