"""Foreign model behind the Detector interface: converts between the network frame and the model's frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from math import pi
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Detections, Proposals
from shift3d.detectors.foreign.checkpoint import load_foreign_net
from shift3d.detectors.foreign.config_common import ForeignOverrides
from shift3d.detectors.foreign.layout import Frame, Layout
from shift3d.detectors.incremental.inference import IncrementalInference
from shift3d.detectors.models.network import Precision
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.errors import InputError

NO_OVERRIDES = ForeignOverrides()
_IOU = 0.25


def foreign_layout(name: str, config: Path, choices: ForeignOverrides = NO_OVERRIDES) -> dict[str, Any]:
    """Read the layout that a config describes, as plain values. name: "openpcdet" or "mmdet3d".

    Raises: InputError with file and value if something is missing or not supported.
    """
    if not config.is_file():
        raise InputError("no such file", str(config), "Check detector.config")
    if name == "openpcdet":
        from shift3d.detectors.foreign.openpcdet import openpcdet_layout as read
    else:
        from shift3d.detectors.foreign.mmdet3d import mmdet3d_layout as read
    return read(config, choices).model_dump(mode="json")


def load_foreign(layout: Mapping[str, Any], weights: Path, precision: Precision = "float32") -> ForeignDetector:
    """Load a detector from a layout of `foreign_layout` and a checkpoint. Raises: InputError as `load_foreign_net`."""
    made = Layout.model_validate(layout)
    net = load_foreign_net(weights, made)
    if precision == "float64":
        net = net.double()  # before norms are folded: folding rounds to the dtype of the weights
    return ForeignDetector(TrainedDetector(net, precision), made)


class ForeignDetector:
    """Detector that converts points to the model's frame and boxes back. Differentiable as `Detector` requires.

    Every anchor or cell is a proposal with the logit of the vehicle class, independent of its other classes. Both
    codebases treat classes separately, too (OpenPCDet with MULTI_CLASSES_NMS).
    """

    def __init__(self, inner: TrainedDetector, layout: Layout) -> None:
        self.name, self.layout = inner.name, layout
        self._inner, self._frame = inner, layout.frame

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """See `Detector`; the window is in cells of the model."""
        x, y = centre_xy
        return self._inner.window_for((-y, x) if self._frame.turned else (x, y), radius_m)

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        return _proposals_back(self._inner.proposals(_to_model(points, self._frame), window), self._frame)

    def incremental(self, window: BevWindow) -> IncrementalInference:
        return _Incremental(self._inner.incremental(window), self._frame)

    def detect(
        self,
        points: Tensor,
        window: BevWindow | None = None,
        score_threshold: float = 0.1,
        iou_threshold: float | None = None,
    ) -> Detections:
        """See `Detector`. iou_threshold: None: that of the config, or 0.25 if the config suppresses by distance."""
        own = _IOU if self.layout.suppression_iou is None else self.layout.suppression_iou
        overlap = own if iou_threshold is None else iou_threshold
        found = self._inner.detect(_to_model(points, self._frame), window, score_threshold, overlap)
        return Detections(_boxes_back(torch.from_numpy(found.boxes), self._frame).numpy(), found.scores)


class _Incremental:
    """`IncrementalInference` that converts between the network frame and the model's frame."""

    def __init__(self, inner: IncrementalInference, frame: Frame) -> None:
        self._inner, self._frame = inner, frame

    def proposals(
        self, points: Tensor, window: BevWindow | None = None, requires_grad: Tensor | None = None
    ) -> Proposals:
        found = self._inner.proposals(_to_model(points, self._frame), window, requires_grad)
        return _proposals_back(found, self._frame)

    def fork(self) -> _Incremental:
        return _Incremental(self._inner.fork(), self._frame)


def _to_model(points: Tensor, frame: Frame) -> Tensor:
    """Convert points (N, 3) from the network frame to the model's frame. Differentiable."""
    if points.ndim != 2 or points.shape[1] != 3:
        return points  # the inner detector raises the error
    x, y, z = points.unbind(1)
    x, y = (-y, x) if frame.turned else (x, y)
    return torch.stack((x, y, z - frame.height_m), dim=1)


def _boxes_back(boxes: Tensor, frame: Frame) -> Tensor:
    """Convert boxes (A, 7) from the model's frame to the network frame."""
    x, y, z, *size, heading = boxes.unbind(1)
    if frame.turned:
        x, y, heading = y, -x, torch.remainder(heading - pi / 2 + pi, 2 * pi) - pi
    return torch.stack((x, y, z + frame.height_m, *size, heading), dim=1)


def _proposals_back(found: Proposals, frame: Frame) -> Proposals:
    return dataclasses.replace(found, boxes=_boxes_back(found.boxes, frame))
