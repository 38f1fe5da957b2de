"""recall(t) = P(score > t), and the area under it is the mean score."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shift3d.evaluation.recall_curve import area_under, recall_curve

SCORES = st.lists(st.floats(0, 1), min_size=1, max_size=60)


@given(SCORES)
def test_area_is_the_mean_score(scores: list[float]) -> None:
    assert area_under(recall_curve(scores)) == pytest.approx(np.mean(scores), abs=1e-12)


@given(SCORES, st.floats(0, 1))
def test_recall_is_the_share_of_scores_above_the_threshold(scores: list[float], threshold: float) -> None:
    curve = recall_curve(scores)
    at = np.searchsorted(curve.score_threshold, threshold, side="right") - 1
    assert curve.recall[at] == np.mean(np.asarray(scores) > threshold)


def test_by_hand() -> None:
    curve = recall_curve([0.5, 0.0, 0.5, 1.0])
    assert curve.score_threshold.tolist() == [0.0, 0.5, 1.0]
    assert curve.recall.tolist() == [0.75, 0.25, 0.0]
    assert area_under(curve) == 0.5


@pytest.mark.parametrize("scores", [[], [1.1], [-0.1], [float("nan")]])
def test_bad_scores_are_refused(scores: list[float]) -> None:
    with pytest.raises(ValueError):
        recall_curve(scores)
