"""Threshold-recall curves and the area under them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RecallCurve:
    """recall(t) = P(score > t), exactly: a step function, constant from each threshold to the next.

    score_threshold: (K,) float64, ascending, from 0 to 1. recall: (K,) float64, in [0, 1], non-increasing;
    ``recall[i]`` holds on [score_threshold[i], score_threshold[i + 1]), the last one at 1 alone.
    """

    score_threshold: FloatArray
    recall: FloatArray


def recall_curve(scores: npt.ArrayLike) -> RecallCurve:
    """The share of inserted vehicles that are detected above each score threshold.

    Args: scores: (N,) best score of each vehicle, 0 where no box was near it, in [0, 1].

    Raises: ValueError: no score, or one outside [0, 1] or NaN.

    Source: SHIFT3D section Evaluation Metrics (a detection has a score GREATER than the threshold). Knots at
    the scores themselves are our choice: nothing is lost to a grid of thresholds.
    """
    values = np.asarray(scores, dtype=np.float64).ravel()
    if values.size == 0:
        raise ValueError("a recall curve needs at least one score")
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError("scores must lie in [0, 1]")
    knots = np.union1d(values, np.array([0.0, 1.0]))
    above = values.size - np.searchsorted(np.sort(values), knots, side="right")
    return RecallCurve(knots, above / values.size)


def area_under(curve: RecallCurve) -> float:
    """Area under a curve on [0, 1]. It equals the mean score: E[s] is the integral of P(s > t).

    Source: SHIFT3D section Evaluation Metrics.
    """
    widths = np.diff(curve.score_threshold)
    return float(np.sum(curve.recall[:-1] * widths))
