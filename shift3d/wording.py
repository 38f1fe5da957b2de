"""Words of messages."""

from __future__ import annotations

__all__ = ["counted", "duration"]


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """``1 task``, ``2 tasks``. plural: of nouns whose plural is not made by an s."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def duration(seconds: float) -> str:
    """``340 ms``, ``5.2 s``, ``12 min``, ``3.5 h``, ``4 days``: three digits, in the largest unit that fits twice."""
    for size, name in ((86_400, "days"), (3_600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * max(seconds, 0.0):.3g} ms"
