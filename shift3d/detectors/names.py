"""Names of the detectors: the single list for settings, commands and weights. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal, get_args

TrainedName = Literal["pointpillars", "centerpoint", "sst", "sst_small"]
ForeignName = Literal["openpcdet", "mmdet3d"]
DetectorName = Literal[TrainedName, ForeignName, "own", "onnx"]
DETECTOR_NAMES: tuple[str, ...] = get_args(TrainedName)
"""Detectors that shift3d ships."""
ONNX_EXPORTABLE = ("pointpillars", "centerpoint")
"""Detectors that can be exported as ONNX files, see `detectors.compiled`."""
OWN = "own"
"""The user's own detector, see `detectors.user_detector`."""
FOREIGN: tuple[str, ...] = get_args(ForeignName)
"""Detectors trained with other codebases, see `detectors.foreign`."""
ONNX = "onnx"
"""An ONNX file, which gives no gradient, see `detectors.compiled`."""
GRID_REACH_M = 74.88
"""Half extent in x and y of the grid of every shipped detector: see `grid.WAYMO_GRID`."""
