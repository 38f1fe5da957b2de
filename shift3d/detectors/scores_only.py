"""Detectors of boxes and scores alone, without a gradient: ONNX files, and programs that a user's Python file calls."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.nms import NmsDetector
from shift3d.errors import InputError

_SATURATED = 2.0**-24
"""Smallest distance of scores from 0 and 1, where logits are infinite; 1 minus this is the last float32 below 1."""
_PROBE_POINTS = 2000


class ScoresOnlyDetector(NmsDetector):
    """Detector that returns boxes and scores without a gradient. It gets the whole scene in every call.

    The cells of a window are squares of 1 m, and cell (0, 0) begins at the origin of the network frame. A window
    selects the boxes with centres in its core as proposals: a file without suppression outputs half a million boxes,
    and computing all their overlaps costs more than the network.

    Args: name: of the detector. where: its file in error messages. remedy: for scores outside [0, 1].
    """

    def __init__(self, name: str, where: str, remedy: str) -> None:
        self.name, self.where, self._remedy = name, where, remedy

    @abstractmethod
    def answer(self, points: Tensor) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return boxes (A, 7) and scores (A,) in [0, 1] for points (N, 3) float32, network frame. A may vary."""
        ...

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """See `Detector`: the window applies to the centres of boxes."""
        (x0, num_x), (y0, num_y) = (
            (math.floor(centre - radius_m), math.ceil(centre + radius_m) - math.floor(centre - radius_m))
            for centre in centre_xy
        )
        return BevWindow(x0, y0, num_x, num_y, x0, y0, num_x, num_y)

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        """See `Detector`; float64 logits, no gradient. Raises InputError if the model fails or its output is bad."""
        # A copy: a model that moves its points in place must not move those of the scene.
        boxes, scores = self.answer(points.detach().to(torch.float32, copy=True))
        with np.errstate(over="ignore"):
            boxes = boxes.astype(np.float32)
        self._check(boxes, scores)
        kept = np.arange(len(scores)) if window is None else np.flatnonzero(_inside(boxes, window))
        logits = torch.logit(torch.from_numpy(scores[kept]).double(), eps=_SATURATED)
        return Proposals(torch.from_numpy(boxes[kept]), logits, torch.from_numpy(kept))

    def try_on_random_points(self) -> None:
        """Run the detector on two numbers of points, and twice on the same points. Raises InputError."""
        points = probe_points()
        first, second = self.proposals(points), self.proposals(points)
        if not torch.equal(first.logits, second.logits) or not torch.equal(first.boxes, second.boxes):
            raise InputError("two calls with the same points differ", self.where, "Draw nothing at random in the model")
        self.proposals(points[: _PROBE_POINTS // 2])

    def _check(self, boxes: npt.NDArray[Any], scores: npt.NDArray[Any]) -> None:
        guide = "See docs/guides/detectors.md"
        if boxes.ndim != 2 or boxes.shape[1] != 7 or scores.shape != boxes.shape[:1]:
            what = f"its answer is boxes {boxes.shape} and scores {scores.shape}, not (A, 7) and (A,)"
            raise InputError(what, self.where, guide)
        if not np.isfinite(boxes).all() or not np.isfinite(scores).all():
            raise InputError("NaN or infinity in its answer", self.where, "Repair the model")
        if len(scores) and not (scores.min() >= 0.0 and scores.max() <= 1.0):
            what = f"its scores reach from {scores.min():g} to {scores.max():g}, not within [0, 1]"
            raise InputError(what, self.where, self._remedy)
        if (boxes[:, 3:6] <= 0).any():
            raise InputError("boxes without a size in its answer", self.where, guide)


def _inside(boxes: npt.NDArray[Any], window: BevWindow) -> npt.NDArray[np.bool_]:
    """Return the mask (A,) bool of boxes with their centre in the window's core."""
    x, y = boxes[:, 0] - window.core_x0, boxes[:, 1] - window.core_y0
    return (x >= 0) & (x < window.core_num_x) & (y >= 0) & (y < window.core_num_y)


def probe_points() -> Tensor:
    """Draw the points (2000, 3) float32, network frame, on which a user's detector is tried; always the same."""
    reach, corner = torch.tensor([80.0, 80.0, 3.0]), torch.tensor([40.0, 40.0, 0.0])
    return torch.rand(_PROBE_POINTS, 3, generator=torch.Generator().manual_seed(0)) * reach - corner
