"""The progress bar of every long command."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm


def progress_bar(work: Iterable[Any] | None = None, slow_s: float = 15.0, **settings: Any) -> tqdm[Any]:
    """A bar on stderr; where that is no terminal, a line every `slow_s` seconds. settings: of tqdm."""
    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    pace = {"mininterval": 0.2, "maxinterval": 1.0} if terminal else {"mininterval": slow_s, "maxinterval": 4 * slow_s}
    return tqdm(work, file=sys.stderr, dynamic_ncols=True, **pace, **settings)


def write_line(text: str) -> None:
    """A line on stderr, above the bars that are there."""
    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)
