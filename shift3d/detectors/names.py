"""The detectors by name: the one list that settings, commands and weights go by. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal, get_args

__all__ = ["DETECTOR_NAMES", "DetectorName"]

DetectorName = Literal["pointpillars", "centerpoint", "sst", "sst_small"]
DETECTOR_NAMES: tuple[str, ...] = get_args(DetectorName)
