"""Whether a compiled detector scores as the one that it was compiled from."""

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
"""Boxes after suppression whose centres are this near are of one object. Which of two boxes with equal scores is kept
hangs on a rounding, and two vehicles are farther apart."""


@dataclass(frozen=True)
class Disagreement:
    """Where two detectors differ most: the scene, a box's centre in it, and the scores of both, 0 for no box."""

    scene: str
    x_m: float
    y_m: float
    original: float
    compiled: float

    @property
    def difference(self) -> float:
        """Of the scores, absolute."""
        return abs(self.original - self.compiled)


def largest_disagreement(
    original: Detector, compiled: Detector, clouds: Iterable[tuple[str, Tensor]]
) -> Disagreement | None:
    """The largest difference of scores over some scenes; None where neither finds anything.

    clouds: names and points (N, 3), network frame. At every box of a score of 0.1 or more, the best scores of both
    within 2 m are compared. Source: our choice.
    """
    found: list[Disagreement] = []
    for name, points in clouds:
        # A box at the least score may lie below it in the other, by no more than what is tolerated.
        one, two = (detector.detect(points, score_threshold=_LEAST - TOLERANCE) for detector in (original, compiled))
        for x, y in np.concatenate([found.boxes[found.scores >= _LEAST] for found in (one, two)])[:, :2]:
            found.append(Disagreement(name, float(x), float(y), _best_near(one, x, y), _best_near(two, x, y)))
    return max(found, key=lambda place: place.difference, default=None)


def require_agreement(
    original: Detector, compiled: Detector, clouds: Iterable[tuple[str, Tensor]], where: str
) -> Disagreement:
    """The largest difference of scores, which is at most TOLERANCE.

    Raises: InputError naming the place where it is larger; or neither finds anything, so that nothing is compared.
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
