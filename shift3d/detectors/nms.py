"""Greedy non-maximum suppression (NMS) by exact IoU of rotated boxes in bird's-eye view (BEV).

The base classes of detectors that use it: with a gradient, and with boxes and scores only.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Detector, Proposals
from shift3d.errors import InputError
from shift3d.geometry.iou import iou_bev

MAX_BEFORE_NMS, MAX_KEPT = 4096, 500
_SATURATED = 2.0**-24
"""Smallest distance of scores from 0 and 1, where logits are infinite; 1 minus this is the last float32 below 1."""
PROBE_POINTS = 2000

Array = npt.NDArray[np.float64]


def rotated_nms(
    boxes: Array,
    scores: Array,
    iou_threshold: float,
    max_kept: int = MAX_KEPT,
    until: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[np.int64]:
    """Return the indices of the kept boxes, highest score first; of equal scores the lower index comes first.

    boxes: (N, 7) metres; scores: (N,). A box is dropped if its BEV IoU with a kept box is above iou_threshold. Exact
    overlaps are computed only for boxes whose circumscribed circles meet. until: (N,) bool; suppression stops after it
    has kept the first of these boxes, because later boxes cannot change the ones already kept. Not differentiable.
    Source: the detector's public config; deterministic order is our choice.
    """
    order = np.argsort(-scores, kind="stable")
    ordered = np.asarray(boxes, dtype=np.float64)[order]
    radius = 0.5 * np.hypot(ordered[:, 3], ordered[:, 4])
    alive = np.ones(len(ordered), dtype=bool)
    kept: list[int] = []
    for index in range(len(ordered)):
        if not alive[index]:
            continue
        kept.append(index)
        if len(kept) == max_kept or (until is not None and until[order[index]]):
            break
        rest = index + 1 + np.flatnonzero(alive[index + 1 :])
        distance = np.hypot(*(ordered[rest, :2] - ordered[index, :2]).T)
        near = rest[distance < radius[rest] + radius[index]]
        if near.size:
            overlap = iou_bev(ordered[index : index + 1], ordered[near])[0]
            alive[near[overlap > iou_threshold]] = False
    return order[np.asarray(kept, dtype=np.int64)]


def suppress(
    proposals: Proposals,
    score_threshold: float,
    iou_threshold: float,
    among: Tensor | None = None,
    until: npt.NDArray[np.bool_] | None = None,
) -> Detections:
    """Turn proposals with at least score_threshold into boxes without overlaps, highest score first.

    among: (A,) bool, the reported proposals that may be kept; None: all. until: (A,) bool, see `rotated_nms`. Without
    `until` at most MAX_BEFORE_NMS proposals enter and MAX_KEPT are kept; with `until` there is no limit, so that one of
    its boxes counts no matter how many boxes score higher. Equal scores are sorted by logit, because in float32 every
    logit above 17 has the score 1; equal logits keep the order of the proposals. NaN passes no threshold. Not
    differentiable. Source: the public Waymo config; until and the order of equals are our choice.
    """
    logits = proposals.logits.detach()
    scores = torch.sigmoid(logits).double().numpy()
    wanted = scores >= score_threshold
    for mask in (proposals.reported, among):
        wanted = wanted if mask is None else wanted & mask.numpy()
    candidates = np.flatnonzero(wanted)
    by_logit = np.argsort(-logits.double().numpy()[candidates], kind="stable")
    most, most_kept = (MAX_BEFORE_NMS, MAX_KEPT) if until is None else (len(candidates), len(candidates))
    candidates = candidates[by_logit[:most]]
    boxes = proposals.boxes.detach().double().numpy()[candidates]
    last = None if until is None else until[candidates]
    kept = rotated_nms(boxes, scores[candidates], iou_threshold, most_kept, last)
    return Detections(boxes[kept], scores[candidates][kept])


class NmsDetector(Detector):
    """Detector whose boxes are its proposals after non-maximum suppression."""

    def detect(
        self, points: Tensor, window: BevWindow | None = None, score_threshold: float = 0.1, iou_threshold: float = 0.25
    ) -> Detections:
        """Return the boxes after suppression, highest score first: at most 4096 enter, 500 remain. Not differentiable.

        With a window, only proposals of its core enter suppression.
        Source: the public Waymo config (thresholds 0.1 and 0.25, 4096 and 500).
        """
        with torch.no_grad():
            return suppress(self.proposals(points, window), score_threshold, iou_threshold)


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
        boxes, scores = self.answer(points.detach().to(torch.float32))
        self._check(boxes, scores)
        kept = np.arange(len(scores)) if window is None else np.flatnonzero(_inside(boxes, window))
        logits = torch.logit(torch.from_numpy(scores[kept]).double(), eps=_SATURATED)
        return Proposals(torch.from_numpy(boxes[kept]).float(), logits, torch.from_numpy(kept))

    def try_on_random_points(self) -> None:
        """Run the detector on two numbers of points, and twice on the same points. Raises InputError."""
        points = probe_points()
        first, second = self.proposals(points), self.proposals(points)
        if not torch.equal(first.logits, second.logits) or not torch.equal(first.boxes, second.boxes):
            raise InputError("two calls with the same points differ", self.where, "Draw nothing at random in the model")
        self.proposals(points[: PROBE_POINTS // 2])

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
    return torch.rand(PROBE_POINTS, 3, generator=torch.Generator().manual_seed(0)) * reach - corner
