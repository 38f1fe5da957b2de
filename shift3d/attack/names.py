"""Names of searches and spaces in settings and specs."""

from __future__ import annotations

from typing import Literal

SearchName = Literal["descent", "expectation", "evolution", "random"]
SpaceName = Literal["free", "pca", "parameters", "family"]
GRADIENT_FREE: tuple[SearchName, ...] = ("evolution", "random")
"""Searches that need no gradient of the detector."""
OVER_KINDS: tuple[SearchName, ...] = ("expectation", "random")
"""Searches that can change the kind of vehicle, as the space family asks."""
