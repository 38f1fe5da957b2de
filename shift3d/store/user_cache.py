"""The user's cache folder: what is kept there can be made again, so nobody depends on it."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["user_cache"]


def user_cache() -> Path:
    """``shift3d`` in XDG_CACHE_HOME, or in ~/.cache; it may not be there yet."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "shift3d"
