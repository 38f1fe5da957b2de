"""Comparison of the scores of a compiled detector with those of the original detector."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from shift3d.detectors.base import Detections, Detector
from shift3d.errors import InputError

TOLERANCE = 1e-3
_LEAST = 0.1
_SAME_OBJECT_M = 2.0
"""Boxes after suppression with centres within this distance belong to one object: rounding decides which of two boxes
with equal scores is kept, and two vehicles are farther apart."""


@dataclass(frozen=True)
class ScoreDifference:
    """Largest score difference of two detectors: scene, box centre, and both scores (0: no box)."""

    scene: str
    x_m: float
    y_m: float
    original: float
    compiled: float

    @property
    def difference(self) -> float:
        """Absolute difference of the scores."""
        return abs(self.original - self.compiled)


def largest_disagreement(
    original: Detector, compiled: Detector, clouds: Iterable[tuple[str, Tensor]]
) -> ScoreDifference | None:
    """Return the largest score difference over the scenes, or None if neither detector finds a box.

    clouds: names and points (N, 3), network frame. At every box with a score of at least 0.1, the highest scores of
    both detectors within 2 m are compared. Source: our choice.
    """
    found: list[ScoreDifference] = []
    for name, points in clouds:
        # A box just above the least score may be below it in the other detector, by up to TOLERANCE.
        one, two = (detector.detect(points, score_threshold=_LEAST - TOLERANCE) for detector in (original, compiled))
        for x, y in np.concatenate([found.boxes[found.scores >= _LEAST] for found in (one, two)])[:, :2]:
            found.append(ScoreDifference(name, float(x), float(y), _best_near(one, x, y), _best_near(two, x, y)))
    return max(found, key=lambda place: place.difference, default=None)


def check_score_agreement(
    original: Detector, compiled: Detector, clouds: Iterable[tuple[str, Tensor]], where: str
) -> ScoreDifference:
    """Check that the largest score difference is at most TOLERANCE, and return it.

    Raises: InputError with the place if the difference is larger, or if neither detector finds a box to compare.
    """
    worst = largest_disagreement(original, compiled, clouds)
    if worst is None:
        what = f"neither it nor {original.name} finds a box in the scenes that they are compared on"
        raise InputError(what, where, "Give detector.original=null to go without a comparison")
    if worst.difference > TOLERANCE:
        place = f"in {worst.scene} at ({worst.x_m:.1f}, {worst.y_m:.1f}) m"
        what = (
            f"its score differs from {original.name}'s by {worst.difference:.2g}, more than {TOLERANCE:g}: "
            f"{worst.compiled:.4f} against {worst.original:.4f} {place}"
        )
        raise InputError(what, where, "Export it again from these weights; check frames and units of points and boxes")
    return worst


def _best_near(found: Detections, x: float, y: float) -> float:
    offset: NDArray[np.float64] = found.boxes[:, :2] - (x, y)
    near = np.hypot(*offset.T) <= _SAME_OBJECT_M
    return float(found.scores[near].max()) if near.any() else 0.0
