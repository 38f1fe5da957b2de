"""The detectors by name: the one list that settings, commands and weights go by. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal, get_args

__all__ = ["DETECTOR_NAMES", "ONNX", "OWN", "DetectorName", "TrainedName"]

TrainedName = Literal["pointpillars", "centerpoint", "sst", "sst_small"]
DetectorName = Literal[TrainedName, "own", "onnx"]
DETECTOR_NAMES: tuple[str, ...] = get_args(TrainedName)
"""Detectors of shift3d."""
OWN = "own"
"""The user's own, see `detectors.own`."""
ONNX = "onnx"
"""An ONNX file, which gives no gradient, see `detectors.compiled`."""
