"""Progress bar of a sweep: finished tasks, remaining time and failures."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from shift3d.progress_bar import progress_bar
from shift3d.sweep.execution.worker import Running
from shift3d.wording import counted

_LONG_S = 5.0


class Progress:
    """Bar on stderr; without a terminal, an occasional line.

    Args: total: tasks of the sweep. finished: tasks that earlier runs finished. workers: number shown beside the bar.
    """

    def __init__(self, total: int, finished: int, workers: int) -> None:
        self._failed = 0
        shown = counted(workers, "worker")
        self._bar = progress_bar(total=total, initial=finished, unit="task", desc=shown, smoothing=0.05)

    def close(self) -> None:
        """Close the bar; its last state stays visible."""
        self._bar.close()

    def update(self, done: int, quarantined: int, running: Sequence[Running], workers: int) -> None:
        """Count finished tasks; zero of both only redraws. running: calls in flight, oldest first."""
        self._failed += quarantined
        self._bar.set_description(counted(workers, "worker"), refresh=False)
        parts = [f"{self._failed} failed"] if self._failed else []
        # Long calls are named.
        parts += [f"{running[0].label} {running[0].seconds:.0f} s"] if running and running[0].seconds >= _LONG_S else []
        self._bar.set_postfix_str(", ".join(parts), refresh=False)
        if done or quarantined:
            self._bar.update(done + quarantined)
        elif sys.stderr.isatty():
            self._bar.refresh()

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        self._bar.write(text, file=sys.stderr)
