"""What a detector was to find in one frame, what it found, and how the two overlap: all that metrics read."""

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
class Truth:
    """The labelled vehicles of a frame, in label order.

    boxes: (M, 7) float64, scene frame, metres and radians. num_points: (M,) int64, points in each box.
    counts: (M,) bool; false for vehicles that a detector may find and need not (KITTI's vans and trucks):
    finding one is neither right nor wrong. difficulty: (M,) int64, KITTI's 0 easy, 1 moderate, 2 hard, 3 harder
    than that; -1 where labels carry none. names: M names as the data set gives them. kinds: M kinds of vehicle, such as
    "sedan+roof_box": a body type and what it carries; empty where the labels say nothing.
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

    def where(self, kept: Flags) -> Truth:
        """Those that are kept, (M,) bool."""
        texts = [tuple(text for text, own in zip(column, kept) if own) for column in (self.names, self.kinds)]
        return Truth(self.boxes[kept], self.num_points[kept], self.counts[kept], self.difficulty[kept], *texts)


@dataclass(frozen=True)
class Found:
    """The detections of a frame.

    boxes: (K, 7) float64, scene frame. scores: (K,) float64 in [0, 1]. labelled: (K,) bool; false where a box
    stands outside what the data set has labels for: such a box is no error. image_height_px: (K,) float64, the
    box's height in the camera image, NaN without a camera.
    """

    boxes: Floats
    scores: Floats
    labelled: Flags
    image_height_px: Floats

    @property
    def range_m(self) -> Floats:
        """(K,) horizontal distance of the centres from the sensor."""
        return range_of(self.boxes)

    def at(self, rows: Ints | Flags) -> Found:
        """Those of some rows, in their order."""
        heights = np.asarray(self.image_height_px)[rows]
        return Found(self.boxes[rows], self.scores[rows], self.labelled[rows], heights)


@dataclass(frozen=True)
class DetectedFrame:
    """One frame of a data set with everything that its metrics are computed from."""

    scene: str
    truth: Truth
    found: Found


@dataclass(frozen=True)
class Comparison:
    """A frame seen one way: detections best score first, and their overlap with the truth.

    overlap: (K, M) float64 IoU in the view. heading_accuracy: (K, M) float64 in [0, 1].
    """

    truth: Truth
    found: Found
    overlap: Floats
    heading_accuracy: Floats


def compare(frame: DetectedFrame, view: View) -> Comparison:
    """Order the detections by score and overlap them with the truth.

    Equal scores are ordered by their boxes, so that the order in which detections are given changes nothing.
    """
    found = frame.found.at(np.lexsort((*frame.found.boxes.T[::-1], -frame.found.scores)))
    overlap = (iou_bev if view == "BEV" else iou_3d)(found.boxes, frame.truth.boxes)
    return Comparison(frame.truth, found, overlap, heading_accuracy(found.boxes, frame.truth.boxes))


def heading_accuracy(a: Floats, b: Floats) -> Floats:
    """1 - |difference of headings| / pi of boxes (K, 7) and (M, 7), wrapped: (K, M), 1 where they agree, 0 at pi.

    Source: Waymo's APH (ComputeHeadingAccuracy in its metrics library).
    """
    difference = np.abs(a[:, None, 6] - b[None, :, 6]) % (2.0 * np.pi)
    difference = np.minimum(difference, 2.0 * np.pi - difference)
    accuracy: Floats = np.clip(1.0 - difference / np.pi, 0.0, 1.0)
    return accuracy


def range_of(boxes: Floats) -> Floats:
    """(N,) horizontal distance of the centres of boxes (N, 7) from the sensor, metres."""
    distance: Floats = np.hypot(boxes[:, 0], boxes[:, 1])
    return distance
