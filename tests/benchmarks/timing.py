"""Wall-clock times of calls in one process, and of calls that take turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Timing", "milliseconds", "repeat", "take_turns"]


@dataclass(frozen=True)
class Timing:
    """Times of one call, milliseconds; at least one."""

    samples_ms: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.samples_ms:
            raise ValueError("a timing without samples")

    @staticmethod
    def of(samples_ms: Sequence[float]) -> Timing:
        """Make a timing of these samples."""
        return Timing(tuple(float(sample) for sample in samples_ms))

    @property
    def median(self) -> float:
        """Median, milliseconds."""
        return float(np.median(self.samples_ms))

    @property
    def low(self) -> float:
        """Lower quartile, milliseconds."""
        return float(np.percentile(self.samples_ms, 25))

    @property
    def high(self) -> float:
        """Upper quartile, milliseconds."""
        return float(np.percentile(self.samples_ms, 75))

    @property
    def best(self) -> float:
        """Shortest, milliseconds."""
        return min(self.samples_ms)


def milliseconds(call: Callable[[], object]) -> float:
    """Return the duration of one call."""
    start = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - start)


def repeat(call: Callable[[], object], budget_s: float, least: int = 3, most: int = 50) -> Timing:
    """Call once to warm up, then until the budget is spent, within the least and the most number of calls."""
    call()
    samples: list[float] = []
    while len(samples) < least or (len(samples) < most and sum(samples) < 1e3 * budget_s):
        samples.append(milliseconds(call))
    return Timing.of(samples)


def take_turns(calls: Mapping[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, Timing]:
    """Time alternatives against each other.

    Args:
        calls: name to (call, number of repetitions in a row). There is no warm-up: a call may take minutes.
        rounds: every second round runs the calls in reverse order, so that a machine that grows slower or faster during
            the measurement affects all of them alike.
    """
    samples: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(rounds):
        order = list(calls) if turn % 2 == 0 else list(calls)[::-1]
        for name in order:
            call, times = calls[name]
            samples[name] += [milliseconds(call) for _ in range(times)]
    return {name: Timing.of(values) for name, values in samples.items()}
