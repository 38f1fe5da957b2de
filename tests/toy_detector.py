"""A small detector that is differentiable and real: anchors on a grid, each scoring the points around it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Proposals
from shift3d.detectors.nms import rotated_nms

CELL_M = 1.0
CELLS = 100


class WaveDetector:
    """Detector whose logit is the mean of a wave sin(3 x - 2 y) over the points around the anchor, above the ground.

    A mean, because changes of the number of points occur at silhouettes, which the paper's gradient leaves out.
    """

    name = "wave"

    def __init__(self, gain: float = 5.0, bias: float = 1.0) -> None:
        self.gain, self.bias = gain, bias

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        x0, y0 = (int((c - radius_m) // CELL_M) + CELLS // 2 for c in centre_xy)
        n = int(2 * radius_m / CELL_M) + 2
        return BevWindow(x0, y0, n, n, x0, y0, n, n)

    def _anchors(self, window: BevWindow | None) -> tuple[Tensor, Tensor]:
        w = window or BevWindow(0, 0, CELLS, CELLS, 0, 0, CELLS, CELLS)
        x = torch.arange(w.core_x0, w.core_x0 + w.core_num_x)
        y = torch.arange(w.core_y0, w.core_y0 + w.core_num_y)
        cells = torch.cartesian_prod(x, y)
        centres = (cells - CELLS // 2 + 0.5) * CELL_M
        return centres, cells[:, 0] * CELLS + cells[:, 1]

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        centres, index = self._anchors(window)
        centres = centres.to(points)
        low, high = centres.amin(0) - 4, centres.amax(0) + 4
        inside = ((points[:, :2] > low) & (points[:, :2] < high)).all(-1)
        points = points[inside]
        points = points[points[:, 2] > 0.1]
        weight = torch.exp(-(points[:, None, :2] - centres).square().sum(-1) / (2 * 1.2**2))
        pattern = torch.sin(3.0 * points[:, 0] - 2.0 * points[:, 1])
        liking = (weight * pattern[:, None]).sum(0) / (weight.sum(0) + 5.0)
        size = torch.tensor([4.5, 1.9, 1.6, 0.0]).expand(len(centres), 4)
        boxes = torch.cat((centres.float(), torch.full((len(centres), 1), 0.8), size), 1)
        return Proposals(boxes.detach(), self.gain * liking + self.bias, index)

    def detect(
        self,
        points: Tensor,
        window: BevWindow | None = None,
        score_threshold: float = 0.1,
        iou_threshold: float = 0.25,
    ) -> Detections:
        with torch.no_grad():
            found = self.proposals(points, window)
        scores = torch.sigmoid(found.logits).double().numpy()
        rows = np.flatnonzero(scores >= score_threshold)
        boxes = found.boxes.double().numpy()[rows]
        kept = rotated_nms(boxes, scores[rows], iou_threshold)
        return Detections(boxes[kept], scores[rows][kept])
