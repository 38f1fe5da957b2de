"""A table of texts: what a command prints and a page shows is the same object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from shift3d.analysis.statistics.intervals import Interval

__all__ = ["Cell", "Table", "interval_text", "number"]

Cell = str | tuple[str, ...]
"""A text, or a text and the notes that a page shows below it."""


@dataclass(frozen=True)
class Table:
    """A title, column heads, and lines whose first cell is their head. kinds: a word a line, for a page's style."""

    title: str
    header: Sequence[str]
    lines: Sequence[Sequence[Cell]]
    kinds: Sequence[str] = ()

    def __str__(self) -> str:
        """As printed: columns padded to their widest cell, the first to the left, the others to the right."""
        cells = [list(self.header), *([_plain(cell) for cell in line] for line in self.lines)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        drawn = [
            "  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip() for line in cells
        ]
        return "\n".join([self.title, drawn[0], "-" * (sum(widths) + 2 * (len(widths) - 1)), *drawn[1:]])


def _plain(cell: Cell) -> str:
    return cell if isinstance(cell, str) else cell[0]


def number(value: float | None, digits: int = 3) -> str:
    """0.5 as "0.500", None as "-"."""
    return "-" if value is None else f"{value:.{digits}f}"


def interval_text(interval: Interval, digits: int) -> str:
    """A difference with its sign and its interval: "-0.12 [-0.20, -0.03]"."""
    if math.isinf(interval.high):
        return f"{interval.mean:+.{digits}f} (one scene)"
    return f"{interval.mean:+.{digits}f} [{number(interval.low, digits)}, {number(interval.high, digits)}]"
