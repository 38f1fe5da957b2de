"""Incremental inference: reuses activations of earlier frames of a scene where they did not change.

An attack shows the same scene to a detector some forty times; a few hundred points move from one frame to the next. In
a network of finite receptive field, activations change only near moved points, and a loss around the object needs only
the receptive field of its proposals. `pillars` and `tokens` compute exactly the intersection of both. The result equals
that of the whole scene, up to the order of floating-point sums.
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
        """Return the proposals that the detector returns for the window's core; window None: the cached window.

        points: (N, 3), network frame, metres. Any points give correct results; constant N and order save the most time.
        requires_grad: (N,) bool, the points that need a gradient (None: all); the gradient of others may be missing.
        """
        ...

    def fork(self) -> Self:
        """Return an independent copy that continues from the current frame."""
        ...


def incremental_inference(detector: Detector, window: BevWindow) -> IncrementalInference:
    """Return the detector's incremental inference, or `UncachedInference` if the detector has none."""
    own: Callable[[BevWindow], IncrementalInference] | None = getattr(detector, "incremental", None)
    return UncachedInference(detector, window) if own is None else own(window)


class UncachedInference:
    """Fallback that computes the whole window in every frame."""

    def __init__(self, detector: Detector, window: BevWindow) -> None:
        self._detector, self._window = detector, window

    def proposals(
        self, points: Tensor, window: BevWindow | None = None, requires_grad: Tensor | None = None
    ) -> Proposals:
        return self._detector.proposals(points, window or self._window)

    def fork(self) -> UncachedInference:
        """Return itself, because it has no state."""
        return self


def deepcopy_sharing(frames: T, *shared: Any) -> T:
    """Return a deep copy that shares the given parts, such as networks."""
    return copy.deepcopy(frames, {id(part): part for part in shared})
