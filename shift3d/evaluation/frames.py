"""Ground truth, detections and their overlap per frame: the input of all metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from shift3d.geometry.iou import iou_3d, iou_bev

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
View = Literal["BEV", "3D"]
VIEWS: tuple[View, ...] = ("BEV", "3D")


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth: the labelled vehicles of a frame, in label order.

    boxes: (M, 7) float64, scene frame, metres and radians. num_points: (M,) int64, number of points in each box.
    counts: (M,) bool; False for ignored vehicles (KITTI's vans and trucks): a detection of one is neither a true nor a
    false positive. difficulty: (M,) int64, KITTI's 0 easy, 1 moderate, 2 hard, 3 harder; -1 without. names: M class
    names of the data set. kinds: M kinds, such as "sedan+roof_box" (body type and attachments); empty without.
    """

    boxes: Floats
    num_points: Ints
    counts: Flags
    difficulty: Ints
    names: tuple[str, ...]
    kinds: tuple[str, ...] = ()

    @property
    def range_m(self) -> Floats:
        """(M,) horizontal distance of the centres from the sensor."""
        return range_of(self.boxes)

    def where(self, kept: Flags) -> GroundTruth:
        """Return the vehicles of a mask (M,) bool."""
        texts = [tuple(text for text, own in zip(column, kept) if own) for column in (self.names, self.kinds)]
        return GroundTruth(self.boxes[kept], self.num_points[kept], self.counts[kept], self.difficulty[kept], *texts)


@dataclass(frozen=True)
class FrameDetections:
    """Detections of a frame.

    boxes: (K, 7) float64, scene frame. scores: (K,) float64 in [0, 1]. labelled: (K,) bool; False outside the labelled
    region: no error. image_height_px: (K,) float64, height of the box in the camera image, NaN without a camera.
    """

    boxes: Floats
    scores: Floats
    labelled: Flags
    image_height_px: Floats

    @property
    def range_m(self) -> Floats:
        """(K,) horizontal distance of the centres from the sensor."""
        return range_of(self.boxes)

    def at(self, rows: Ints | Flags) -> FrameDetections:
        """Return the detections of the given rows, in their order."""
        heights = np.asarray(self.image_height_px)[rows]
        return FrameDetections(self.boxes[rows], self.scores[rows], self.labelled[rows], heights)


@dataclass(frozen=True)
class DetectedFrame:
    """Ground truth and detections of one frame of a data set."""

    scene: str
    truth: GroundTruth
    found: FrameDetections


@dataclass(frozen=True)
class Comparison:
    """Frame in one view (BEV or 3D): detections, highest score first, and their overlap with the ground truth.

    overlap: (K, M) float64 IoU in the view. heading_accuracy: (K, M) float64 in [0, 1].
    """

    truth: GroundTruth
    found: FrameDetections
    overlap: Floats
    heading_accuracy: Floats


def compare(frame: DetectedFrame, view: View) -> Comparison:
    """Sort the detections by score and compute their overlap with the ground truth.

    Equal scores are sorted by their boxes, so that the result does not depend on the input order.
    """
    found = frame.found.at(np.lexsort((*frame.found.boxes.T[::-1], -frame.found.scores)))
    overlap = (iou_bev if view == "BEV" else iou_3d)(found.boxes, frame.truth.boxes)
    return Comparison(frame.truth, found, overlap, heading_accuracy(found.boxes, frame.truth.boxes))


def heading_accuracy(a: Floats, b: Floats) -> Floats:
    """Compute 1 - |wrapped difference of headings| / pi of boxes (K, 7) and (M, 7): (K, M), 1 if equal, 0 at pi.

    Source: Waymo's APH (ComputeHeadingAccuracy in its metrics library).
    """
    difference = np.abs(a[:, None, 6] - b[None, :, 6]) % (2.0 * np.pi)
    difference = np.minimum(difference, 2.0 * np.pi - difference)
    accuracy: Floats = np.clip(1.0 - difference / np.pi, 0.0, 1.0)
    return accuracy


def range_of(boxes: Floats) -> Floats:
    """Compute the horizontal distance (N,) of the centres of boxes (N, 7) from the sensor, metres."""
    distance: Floats = np.hypot(boxes[:, 0], boxes[:, 1])
    return distance
