"""SIGINT and SIGTERM handed to a handler for a while, so that long work can end between two steps."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

__all__ = ["stop_signals", "taken_signals"]

_taken = 0


def taken_signals() -> int:
    """How many signals handlers of `stop_signals` have taken in this process.

    Work that was asked to stop may have come to its end: what would follow it asks here whether it is still wanted.
    """
    return _taken


@contextlib.contextmanager
def stop_signals(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Both signals go to the handler while this is open; the handlers before it come back afterwards.

    In a thread other than the main one signals stay as they are, as Python allows nothing else.
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
