"""What one rendering can tell the next."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WarmStart:
    """Placeholder."""
