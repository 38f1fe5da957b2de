"""Progress bar of every long command."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm


def progress_bar(work: Iterable[Any] | None = None, slow_s: float = 15.0, **settings: Any) -> tqdm[Any]:
    """Show progress on stderr: a bar in a terminal, else a line every `slow_s` seconds. settings: arguments of tqdm."""
    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    pace = {"mininterval": 0.2, "maxinterval": 1.0} if terminal else {"mininterval": slow_s, "maxinterval": 4 * slow_s}
    return tqdm(work, file=sys.stderr, dynamic_ncols=True, **pace, **settings)


def write_line(text: str) -> None:
    """Print a line on stderr above the open progress bars."""
    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)
