"""What effects ask about a detector."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectorFacts:
    """What an effect asks about a detector. reads_reflectance: beside coordinates."""

    name: str
    reads_reflectance: bool = False
