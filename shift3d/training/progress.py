"""How a training tells what it does: curves for whoever records them, and an end between two steps when asked."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import FrameType

from shift3d.signals import stop_signals

CurvePoint = tuple[int, Mapping[str, float]]
"""A step (1 for the first), and values by name: parts of the loss, the learning rate."""
Report = Callable[[Sequence[CurvePoint]], None]
"""Called after every checkpoint with the points since the one before: what is reported never has to be taken back."""


def averaged(curve: Sequence[CurvePoint], points: int) -> list[CurvePoint]:
    """The curve by at most about so many points: means of stretches, each at its last step. A single point is noise."""
    length = max(1, -(-len(curve) // max(1, points)))
    found: list[CurvePoint] = []
    for start in range(0, len(curve), length):
        stretch = curve[start : start + length]
        values = {name: sum(value[name] for _, value in stretch) / len(stretch) for name in stretch[-1][1]}
        found.append((stretch[-1][0], values))
    return found


class StopRequest:
    """Whether a training has been asked to end. Asked twice, it ends at once, without a last checkpoint."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """A signal handler."""
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


@contextlib.contextmanager
def stop_on_signal() -> Iterator[StopRequest]:
    """SIGINT and SIGTERM only set a flag while this is open, so that a training can finish its step and save.

    In a thread other than the main one signals stay as they are, and nothing is ever asked.
    """
    request = StopRequest()
    with stop_signals(request):
        yield request


class Stopwatch:
    """Seconds of a training over all its interruptions."""

    def __init__(self, before_s: float = 0.0) -> None:
        self._before_s = before_s
        self._start = time.monotonic()

    @property
    def seconds(self) -> float:
        """So far."""
        return self._before_s + time.monotonic() - self._start
