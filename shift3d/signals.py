"""Temporary handlers of SIGINT and SIGTERM, so that long work can stop between two steps."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

__all__ = ["handle_stop_signals", "received_signals"]

_taken = 0


def received_signals() -> int:
    """Count the signals that handlers of `handle_stop_signals` received in this process.

    Work may finish normally after a stop signal. A caller that sees a larger count than before starts no further work.
    """
    return _taken


@contextlib.contextmanager
def handle_stop_signals(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Send SIGINT and SIGTERM to `handler` inside the context, and restore the previous handlers afterwards.

    Outside the main thread this changes nothing: Python sets signal handlers in the main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def take(number: int, frame: FrameType | None) -> None:
        global _taken
        _taken += 1
        handler(number, frame)

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
