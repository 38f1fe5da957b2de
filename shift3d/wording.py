"""Wording of numbers and durations in messages."""

from __future__ import annotations

__all__ = ["counted", "duration"]


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Format a count, as ``1 task`` or ``2 tasks``. plural: for nouns whose plural does not end in a plain s."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def duration(seconds: float) -> str:
    """Format a duration with three digits in the largest unit that fits twice: ``340 ms``, ``12 min``, ``4 days``."""
    for size, name in ((86_400, "days"), (3_600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * max(seconds, 0.0):.3g} ms"
