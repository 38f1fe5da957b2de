"""Names of searches and spaces in settings and specs."""

from __future__ import annotations

from typing import Literal

SearchName = Literal["descent", "expectation", "evolution", "random"]
SpaceName = Literal["free", "pca", "parameters", "family"]
