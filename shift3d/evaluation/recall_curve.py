"""Recall as a function of the score threshold, and the area under this curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RecallCurve:
    """Exact recall curve recall(t) = P(score > t): a step function, constant between thresholds.

    score_threshold: (K,) float64, ascending, from 0 to 1. recall: (K,) float64, in [0, 1], non-increasing;
    ``recall[i]`` holds on [score_threshold[i], score_threshold[i + 1]), the last value only at 1.
    """

    score_threshold: FloatArray
    recall: FloatArray


def recall_curve(scores: npt.ArrayLike) -> RecallCurve:
    """Compute the share of inserted vehicles detected above each score threshold.

    Args: scores: (N,) highest score of each vehicle, 0 without a box near it, in [0, 1].

    Raises: ValueError without scores, or for a score outside [0, 1] or NaN.

    Source: SHIFT3D section Evaluation Metrics (a detection has a score GREATER than the threshold). The thresholds are
    the scores themselves (our choice), so the curve is exact.
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
    """Compute the area under a curve: the mean score, E[s] = integral P(s > t). Source: SHIFT3D, Evaluation Metrics."""
    widths = np.diff(curve.score_threshold)
    return float(np.sum(curve.recall[:-1] * widths))
