"""The progress bar: how far, how long still, and what failed."""

from __future__ import annotations

import sys
from types import TracebackType

__all__ = ["Progress"]


class Progress:
    """A bar on stderr; where that is no terminal, a line now and then.

    Args:
        total: tasks of the sweep. finished: those that earlier runs finished. workers: shown beside the bar.
    """

    def __init__(self, total: int, finished: int, workers: int) -> None:
        from tqdm import tqdm

        terminal = sys.stderr.isatty()
        self._failed = 0
        self._bar = tqdm(
            total=total,
            initial=finished,
            unit="task",
            desc=f"{workers} worker{'s' if workers > 1 else ''}",
            dynamic_ncols=True,
            mininterval=0.2 if terminal else 15.0,
            maxinterval=1.0 if terminal else 60.0,
            smoothing=0.05,
            file=sys.stderr,
        )

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def update(self, done: int, quarantined: int) -> None:
        """Count finished tasks; zero of both only redraws."""
        if quarantined:
            self._failed += quarantined
            self._bar.set_postfix_str(f"{self._failed} failed", refresh=False)
        if done or quarantined:
            self._bar.update(done + quarantined)
        elif sys.stderr.isatty():
            self._bar.refresh()

    def say(self, text: str) -> None:
        """A line above the bar."""
        self._bar.write(text, file=sys.stderr)
