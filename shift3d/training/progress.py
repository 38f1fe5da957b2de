"""Training progress: loss curves for a recorder, and a clean stop between two steps after a signal."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import FrameType

from shift3d.signals import handle_stop_signals

CURVE_POINTS = 30  # largest number of points of a curve in a provenance file
CurvePoint = tuple[int, Mapping[str, float]]
"""Step (1 for the first), and values by name: parts of the loss, the learning rate."""
Report = Callable[[Sequence[CurvePoint]], None]
"""Called after every checkpoint with the points since the last checkpoint; reported points never change."""


def mean_values(points: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Average each value of the last point over all points."""
    return {name: sum(point[name] for point in points) / len(points) for name in points[-1]}


def downsampled(curve: Sequence[CurvePoint], points: int) -> list[CurvePoint]:
    """Reduce the curve to at most `points` means of stretches, each at its last step. A single point is noise."""
    length = max(1, -(-len(curve) // max(1, points)))
    found: list[CurvePoint] = []
    for start in range(0, len(curve), length):
        stretch = curve[start : start + length]
        found.append((stretch[-1][0], mean_values([values for _, values in stretch])))
    return found


def curve_facts(curve: Sequence[CurvePoint]) -> list[dict[str, float]]:
    """Return the curve for a provenance file: at most `CURVE_POINTS` points, values to four digits."""
    return [
        {"step": step, **{name: float(f"{value:.4g}") for name, value in values.items()}}
        for step, values in downsampled(curve, CURVE_POINTS)
    ]


@contextlib.contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """Yield an event that SIGINT and SIGTERM set, so that a training can finish its step and save.

    A second signal raises KeyboardInterrupt at once, without a last checkpoint. Only the main thread takes signals: in
    another thread the event is never set.
    """
    requested = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if requested.is_set():
            raise KeyboardInterrupt
        requested.set()

    with handle_stop_signals(handle):
        yield requested
