"""How a training tells what it does: curves for whoever records them, and an end between two steps when asked."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import FrameType

from shift3d.signals import stop_signals

CURVE_POINTS = 30
"""About how many points of a curve stand in a provenance."""
CurvePoint = tuple[int, Mapping[str, float]]
"""A step (1 for the first), and values by name: parts of the loss, the learning rate."""
Report = Callable[[Sequence[CurvePoint]], None]
"""Called after every checkpoint with the points since the one before: what is reported never has to be taken back."""


def mean_values(points: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each value of the last point over all of them."""
    return {name: sum(point[name] for point in points) / len(points) for name in points[-1]}


def averaged(curve: Sequence[CurvePoint], points: int) -> list[CurvePoint]:
    """The curve by at most about so many points: means of stretches, each at its last step. A single point is noise."""
    length = max(1, -(-len(curve) // max(1, points)))
    found: list[CurvePoint] = []
    for start in range(0, len(curve), length):
        stretch = curve[start : start + length]
        found.append((stretch[-1][0], mean_values([values for _, values in stretch])))
    return found


def curve_facts(curve: Sequence[CurvePoint]) -> list[dict[str, float]]:
    """The curve for a provenance: at most about `CURVE_POINTS`, values to four digits."""
    return [
        {"step": step, **{name: float(f"{value:.4g}") for name, value in values.items()}}
        for step, values in averaged(curve, CURVE_POINTS)
    ]


@contextlib.contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """SIGINT and SIGTERM only set an event while this is open, so that a training can finish its step and save. Asked
    twice, it ends at once, without a last checkpoint.

    In a thread other than the main one signals stay as they are, and nothing is ever asked.
    """
    requested = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if requested.is_set():
            raise KeyboardInterrupt
        requested.set()

    with stop_signals(handle):
        yield requested
