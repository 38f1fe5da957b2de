"""Incremental inference: reuses activations of earlier frames of a scene where they did not change.

An attack shows the same scene to a detector some forty times; a few hundred points move from one frame to the next. In
a network of finite receptive field, activations change only near moved points, and a loss around the object needs only
the receptive field of its proposals. `pillars` and `tokens` compute exactly the intersection of both. The result equals
that of the whole scene, up to the order of floating-point sums.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Protocol, Self

import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detector, Proposals

Plain = Callable[[Tensor, BevWindow], Proposals]
"""Function of points (N, 3) and a window that computes its proposals without a cache."""


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


class CachedInference(ABC):
    """Inference that keeps the activations of one window. Not for use from several threads at once.

    plain: proposals without cache, for windows beyond the cached one. shared: parts that forks share, such as networks.
    """

    def __init__(self, window: BevWindow, exact: torch.dtype, plain: Plain, *shared: Any) -> None:
        self._window, self._exact, self._plain, self._shared = window, exact, plain, (plain, *shared)

    def proposals(
        self, points: Tensor, window: BevWindow | None = None, requires_grad: Tensor | None = None
    ) -> Proposals:
        """See `IncrementalInference`. A window that extends beyond the cached one is computed without the cache.

        Deterministic bit for bit for the same sequence of calls; other earlier calls may change the rounding.
        """
        window = window or self._window
        if points.ndim != 2 or points.shape[1] != 3 or not _contains(self._window, window):
            return self._plain(points, window)
        return self._cached(points.to(self._exact), window, requires_grad)

    @abstractmethod
    def _cached(self, points: Tensor, window: BevWindow, requires_grad: Tensor | None) -> Proposals:
        """Compute the proposals of a window inside the cached one. points: in the exact dtype."""

    def fork(self) -> Self:
        """Return an independent copy that continues from the current frame."""
        return copy.deepcopy(self, {id(part): part for part in self._shared})


def _contains(outer: BevWindow, inner: BevWindow) -> bool:
    return (
        outer.x0 <= inner.x0
        and outer.y0 <= inner.y0
        and inner.x0 + inner.num_x <= outer.x0 + outer.num_x
        and inner.y0 + inner.num_y <= outer.y0 + outer.num_y
    )
