"""A progress bar in seconds of expected work, for work whose pieces take from a second to minutes."""

from __future__ import annotations

import sys
from types import TracebackType


class SecondsBar:
    """A bar on stderr whose total is what the whole is expected to take; it corrects the expectation as it goes.

    Args: seconds: expected in all.
    """

    def __init__(self, seconds: float) -> None:
        from tqdm import tqdm

        terminal = sys.stderr.isatty()
        self._bar = tqdm(
            total=seconds,
            bar_format="{percentage:3.0f} %|{bar}| {elapsed}<{remaining}{postfix}",
            dynamic_ncols=True,
            mininterval=0.2 if terminal else 30.0,
            smoothing=0.0,
            file=sys.stderr,
        )

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
