"""The detectors by name: the one list that settings, commands and weights go by. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal, get_args

TrainedName = Literal["pointpillars", "centerpoint", "sst", "sst_small"]
ForeignName = Literal["openpcdet", "mmdet3d"]
DetectorName = Literal[TrainedName, ForeignName, "own", "onnx"]
DETECTOR_NAMES: tuple[str, ...] = get_args(TrainedName)
"""Detectors of shift3d."""
COMPILED = ("pointpillars", "centerpoint")
"""Those that can be written as ONNX files, see `detectors.compiled`."""
OWN = "own"
"""The user's own, see `detectors.own`."""
FOREIGN: tuple[str, ...] = get_args(ForeignName)
"""Trained by other codebases, see `detectors.foreign`."""
ONNX = "onnx"
"""An ONNX file, which gives no gradient, see `detectors.compiled`."""
GRID_REACH_M = 74.88
"""How far the grid of every shipped detector goes in x and y, either way: see `grid.WAYMO_GRID`."""
