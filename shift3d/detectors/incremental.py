"""A detector that follows one scene through its editions: what did not change is not computed again.

An attack shows a detector the same scene some forty times; between two times a few hundred points move. A network of
finite receptive field then changes only around these, and a loss around the object needs only what its proposals see.
Exactly that is computed (`pillar_follower`, `token_follower`). The result is that of the whole scene, up to the order
of floating-point sums.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import Tensor

from shift3d.detectors.base import BevWindow, Detector, Proposals

__all__ = ["Follower", "WindowFollower", "follow"]


class Follower(Protocol):
    """`Detector.proposals` for many editions of one scene."""

    def proposals(self, points: Tensor, window: BevWindow | None = None, live: Tensor | None = None) -> Proposals:
        """As the detector's own, of the window's core; window None: of the window that is followed.

        points: (N, 3), network frame, metres. N and the order stay the same where as much as possible is to be
        saved; any points are right. live: (N,) bool, the points whose gradient is asked for; that of others may
        be missing. None: all of them.
        """
        ...


@runtime_checkable
class _CanFollow(Protocol):
    def following(self, window: BevWindow) -> Follower: ...


def follow(detector: Detector, window: BevWindow) -> Follower:
    """A follower of any detector: its own, or one that computes everything anew each time."""
    return detector.following(window) if isinstance(detector, _CanFollow) else WindowFollower(detector, window)


class WindowFollower:
    """Follows by computing the whole window each time."""

    def __init__(self, detector: Detector, window: BevWindow) -> None:
        self._detector, self._window = detector, window

    def proposals(self, points: Tensor, window: BevWindow | None = None, live: Tensor | None = None) -> Proposals:
        """See `Follower`."""
        return self._detector.proposals(points, window or self._window)
