"""Measured numbers as people read them: three digits and the unit that suits them."""

from __future__ import annotations

import math

__all__ = ["factor", "length", "milliseconds", "share"]

_UNITS_M = ((1.0, "m"), (1e-3, "mm"), (1e-6, "\N{MICRO SIGN}m"), (1e-9, "nm"))


def length(metres: float) -> str:
    """0.00012 as "120 µm"; what is below a thousandth of a nanometre as "0"."""
    if abs(metres) < 1e-12:
        return "0"
    scale, unit = next((pair for pair in _UNITS_M if abs(metres) >= 0.9995 * pair[0]), _UNITS_M[-1])
    return f"{_digits(metres / scale)} {unit}"


def milliseconds(value: float) -> str:
    """812.3 as "812 ms", 5310 as "5.31 s"."""
    return f"{_digits(value / 1000)} s" if value >= 999.5 else f"{_digits(value)} ms"


def share(fraction: float) -> str:
    """0.00031 as "0.031 %"; 0 as "0"."""
    return "0" if fraction == 0 else f"{_digits(100 * fraction)} %"


def factor(ratio: float) -> str:
    """387.2 as "387", 1.2345 as "1.23", 12345 as "12,300"."""
    return _digits(ratio)


def _digits(value: float) -> str:
    """Three significant digits, no trailing zeros, no exponent above a millionth, thousands apart."""
    if value == 0:
        return "0"
    decimals = 2 - math.floor(math.log10(abs(value)))
    rounded = round(value, decimals)
    if abs(rounded) < 1e-6:
        return f"{rounded:.2e}"
    text = f"{rounded:,.{max(0, decimals)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
