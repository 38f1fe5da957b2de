"""Detector interface: proposals with gradients, and boxes after non-maximum suppression."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from torch import Tensor


@dataclass(frozen=True)
class BevWindow:
    """Part of a bird's-eye grid, in cells of that grid, never in metres.

    The network runs on the outer rectangle (x0, y0, num_x, num_y) and returns proposals of the core only. The ring
    between the two rectangles is the margin of the receptive field: proposals of the core equal those of the full
    scene. Cell (0, 0) begins at the grid's origin, for a `Grid` its corner with the smallest x and y.

    The grid is that of the detector whose `window_for` made the window: the pillars of a network, squares of 1 m of an
    ONNX file. A function with arguments ``grid`` and ``window`` takes a window in cells of this grid. Heads have a
    coarser grid than pillars: see `DetectorNet.head_grid` and `DetectorNet.head_window`.
    """

    x0: int
    y0: int
    num_x: int
    num_y: int
    core_x0: int
    core_y0: int
    core_num_x: int
    core_num_y: int


@dataclass(frozen=True)
class Proposals:
    """Box and logit of every anchor before non-maximum suppression.

    boxes: (A, 7) float32, detached, network frame (x, y, z, dx, dy, dz, heading), metres and radians.
    logits: (A,) differentiable w.r.t. the points; the score is sigmoid(logit).
    anchor_index: (A,) int64, index of the anchor in the FULL grid (the same for any window).
    reported: (A,) bool, True for proposals that enter suppression, e.g. the peaks of a heat map; None: all enter.
    """

    boxes: Tensor
    logits: Tensor
    anchor_index: Tensor
    reported: Tensor | None = None


@dataclass(frozen=True)
class Detections:
    """Boxes after suppression, best first: boxes (K, 7) float64, network frame; scores (K,) float64 in [0, 1]."""

    boxes: npt.NDArray[np.float64]
    scores: npt.NDArray[np.float64]


class Detector(Protocol):
    """3D vehicle detector. Points are in the network frame: z is measured from the ground."""

    name: str

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """Return the smallest window whose proposals with anchor centres within radius_m equal the full scene's."""
        ...

    @abstractmethod
    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        """Score every anchor. points: (N, 3). Differentiable w.r.t. points, through the logits."""
        ...

    def detect(
        self, points: Tensor, window: BevWindow | None = None, score_threshold: float = 0.1, iou_threshold: float = 0.25
    ) -> Detections:
        """Return the boxes after rotated non-maximum suppression. Not differentiable."""
        ...
