"""A precision-recall curve with the areas under it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PrecisionRecall:
    """What became of all frames' detections as the score threshold moves.

    average_precision: AP in [0, 1]; average_precision_heading: APH, at most AP. Both None where there was nothing
    to find. score_threshold, recall, precision, heading_precision: (K,) float64, one row a point of the curve;
    heading_precision counts each right detection by its heading accuracy. num_truth: objects to find.
    """

    average_precision: float | None
    average_precision_heading: float | None
    score_threshold: Floats
    recall: Floats
    precision: Floats
    heading_precision: Floats
    num_truth: int
