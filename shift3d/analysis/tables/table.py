"""Table of texts for terminal and pages, and number formats for readers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from shift3d.analysis.statistics.intervals import Interval

_UNITS_M = ((1.0, "m"), (1e-3, "mm"), (1e-6, "\N{MICRO SIGN}m"), (1e-9, "nm"))


def length(metres: float) -> str:
    """Format metres: 0.00012 as "120 µm", less than a thousandth of a nanometre as "0"."""
    if abs(metres) < 1e-12:
        return "0"
    scale, unit = next((pair for pair in _UNITS_M if abs(metres) >= 0.9995 * pair[0]), _UNITS_M[-1])
    return f"{factor(metres / scale)} {unit}"


def milliseconds(value: float) -> str:
    """Format milliseconds: 812.3 as "812 ms", 5310 as "5.31 s"."""
    return f"{factor(value / 1000)} s" if value >= 999.5 else f"{factor(value)} ms"


def share(fraction: float) -> str:
    """Format a fraction: 0.00031 as "0.031 %", 0 as "0"."""
    return "0" if fraction == 0 else f"{factor(100 * fraction)} %"


def factor(value: float) -> str:
    """Format with three significant digits: 387.2 as "387", 1.2345 as "1.23", 12345 as "12,300".

    No trailing zeros, no exponent above a millionth, thousands separated.
    """
    if value == 0:
        return "0"
    decimals = 2 - math.floor(math.log10(abs(value)))
    rounded = round(value, decimals)
    if abs(rounded) < 1e-6:
        return f"{rounded:.2e}"
    text = f"{rounded:,.{max(0, decimals)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


Cell = str | tuple[str, ...]  # A text, or a text and the notes that a page shows below it.


@dataclass(frozen=True)
class Table:
    """Table with title, column heads and lines; a line's first cell is its head. kinds: one CSS class per line."""

    title: str
    header: Sequence[str]
    lines: Sequence[Sequence[Cell]]
    kinds: Sequence[str] = ()

    def __str__(self) -> str:
        """Format for the terminal: columns padded to their widest cell, the first left-, the others right-aligned."""
        cells = [list(self.header), *([_plain(cell) for cell in line] for line in self.lines)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        drawn = [
            "  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip() for line in cells
        ]
        return "\n".join([self.title, drawn[0], "-" * (sum(widths) + 2 * (len(widths) - 1)), *drawn[1:]])


def _plain(cell: Cell) -> str:
    return cell if isinstance(cell, str) else cell[0]


def number(value: float | None, digits: int = 3) -> str:
    """Format a number: 0.5 as "0.500", None and NaN as "-"."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def between(interval: Interval, digits: int, sign: str = "") -> str:
    """Format an interval's ends: "[-0.20, -0.03]", or "" for an infinite interval. sign: "+" shows plus signs."""
    if math.isinf(interval.low):
        return ""
    return f"[{interval.low:{sign}.{digits}f}, {interval.high:{sign}.{digits}f}]"


def interval_text(interval: Interval | None, digits: int, sign: str = "+") -> str:
    """Format a value with its interval: "-0.12 [-0.20, -0.03]", None as "-". sign: "" unless it is a difference."""
    if interval is None:
        return "-"
    return f"{interval.mean:{sign}.{digits}f} {between(interval, digits, sign) or '(one scene)'}"
