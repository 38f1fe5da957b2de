"""The progress bar: how far, how long still, and what failed."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from shift3d.progress_bar import progress_bar
from shift3d.sweep.execution.worker import Running
from shift3d.wording import counted

_LONG_S = 5.0


class Progress:
    """A bar on stderr; where that is no terminal, a line now and then.

    Args: total: tasks of the sweep. finished: those that earlier runs finished. workers: shown beside the bar.
    """

    def __init__(self, total: int, finished: int, workers: int) -> None:
        self._failed = 0
        shown = counted(workers, "worker")
        self._bar = progress_bar(total=total, initial=finished, unit="task", desc=shown, smoothing=0.05)

    def close(self) -> None:
        """The bar's last state stays."""
        self._bar.close()

    def update(self, done: int, quarantined: int, running: Sequence[Running], workers: int) -> None:
        """Count finished tasks; zero of both only redraws. running: what is in flight, the oldest first."""
        self._failed += quarantined
        self._bar.set_description(counted(workers, "worker"), refresh=False)
        parts = [f"{self._failed} failed"] if self._failed else []
        # Of calls that take a while it is worth knowing which they are.
        parts += [f"{running[0].label} {running[0].seconds:.0f} s"] if running and running[0].seconds >= _LONG_S else []
        self._bar.set_postfix_str(", ".join(parts), refresh=False)
        if done or quarantined:
            self._bar.update(done + quarantined)
        elif sys.stderr.isatty():
            self._bar.refresh()

    def say(self, text: str) -> None:
        """A line above the bar."""
        self._bar.write(text, file=sys.stderr)
