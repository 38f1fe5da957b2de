"""Incremental inference: from frame to frame of one scene, what did not change is not computed again.

An attack shows a detector the same scene some forty times; between two times a few hundred points move. A network of
finite receptive field then changes only around these, and a loss around the object needs only what its proposals see.
Exactly that is computed (`pillars`, `tokens`). The result is that of the whole scene, up to the order
of floating-point sums.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Protocol, Self, TypeVar

from torch import Tensor

from shift3d.detectors.base import BevWindow, Detector, Proposals

T = TypeVar("T")


class IncrementalInference(Protocol):
    """`Detector.proposals` for many frames of one scene."""

    def proposals(
        self, points: Tensor, window: BevWindow | None = None, requires_grad: Tensor | None = None
    ) -> Proposals:
        """As the detector's own, of the window's core; window None: of the cached one.

        points: (N, 3), network frame, metres. N and the order stay the same where as much as possible is to be
        saved; any points are right. requires_grad: (N,) bool, the points whose gradient is asked for; that of
        others may be missing. None: all of them.
        """
        ...

    def fork(self) -> Self:
        """A second one that goes on from the frame of this one; neither changes the other."""
        ...


def incremental_inference(detector: Detector, window: BevWindow) -> IncrementalInference:
    """A detector's own incremental inference, or one that computes the whole window in every frame."""
    own: Callable[[BevWindow], IncrementalInference] | None = getattr(detector, "incremental", None)
    return WholeWindow(detector, window) if own is None else own(window)


class WholeWindow:
    """Computes the whole window in every frame."""

    def __init__(self, detector: Detector, window: BevWindow) -> None:
        self._detector, self._window = detector, window

    def proposals(
        self, points: Tensor, window: BevWindow | None = None, requires_grad: Tensor | None = None
    ) -> Proposals:
        return self._detector.proposals(points, window or self._window)

    def fork(self) -> WholeWindow:
        """Itself: it keeps nothing."""
        return self


def copied_but_for(frames: T, *shared: Any) -> T:
    """A deep copy that shares some parts, such as networks."""
    return copy.deepcopy(frames, {id(part): part for part in shared})
