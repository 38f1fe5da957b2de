"""A progress bar in seconds of expected work, for work whose pieces take from a second to minutes."""

from __future__ import annotations

import sys
from types import TracebackType

from shift3d.progress_bar import progress_bar


class SecondsBar:
    """A bar on stderr whose total is what the whole is expected to take; it corrects the expectation as it goes.

    Args: seconds: expected in all.
    """

    def __init__(self, seconds: float) -> None:
        shown = "{percentage:3.0f} %|{bar}| {elapsed}<{remaining}{postfix}"
        self._bar = progress_bar(slow_s=30.0, total=seconds, bar_format=shown, smoothing=0.0)

    def __enter__(self) -> SecondsBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def tell(self, name: str, seconds: float, known: bool) -> None:
        """Name what is under way, and count what is done; what was known before takes no part in the speed."""
        self._bar.set_postfix_str(name, refresh=sys.stderr.isatty() and not known)
        if known:
            self._bar.initial += seconds
        self._bar.update(min(seconds, max(0.0, self._bar.total - self._bar.n)))
