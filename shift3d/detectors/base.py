"""What a detector offers the rest of the package: proposals with gradients, and boxes after suppression."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from torch import Tensor


@dataclass(frozen=True)
class BevWindow:
    """Part of the detector's bird's-eye grid, in cells.

    The network runs on the outer rectangle; proposals are reported for the core alone. The ring between
    them is the receptive field's margin, so that what the core reports equals the full scene's result.
    Cell (0, 0) is the grid's corner at the least x and y.
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
    """Every anchor's box and logit before suppression.

    boxes: (A, 7) float32, detached, network frame (x, y, z, dx, dy, dz, heading), metres and radians.
    logits: (A,) differentiable w.r.t. the points; the score is sigmoid(logit).
    anchor_index: (A,) int64, the anchor's index in the FULL grid (the same for any window).
    reported: (A,) bool, those that suppression is given, as the peaks of a heat map; None: all.
    """

    boxes: Tensor
    logits: Tensor
    anchor_index: Tensor
    reported: Tensor | None = None


@dataclass(frozen=True)
class Detections:
    """Boxes kept by suppression, best first.

    boxes: (K, 7) float64, network frame; scores: (K,) float64 in [0, 1].
    """

    boxes: npt.NDArray[np.float64]
    scores: npt.NDArray[np.float64]


class Detector(Protocol):
    """A 3D vehicle detector. Points are in the network frame: z measured from the ground."""

    name: str

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """Smallest window whose proposals with anchor centres within radius_m equal the full scene's."""
        ...

    @abstractmethod
    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        """Score every anchor. points: (N, 3). Differentiable w.r.t. points, through the logits."""
        ...

    def detect(
        self, points: Tensor, window: BevWindow | None = None, score_threshold: float = 0.1, iou_threshold: float = 0.25
    ) -> Detections:
        """Boxes after rotated suppression. Not differentiable."""
        ...
