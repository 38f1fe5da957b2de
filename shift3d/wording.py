"""Words of messages."""

from __future__ import annotations

__all__ = ["counted"]


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """``1 task``, ``2 tasks``. plural: of nouns whose plural is not made by an s."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"
