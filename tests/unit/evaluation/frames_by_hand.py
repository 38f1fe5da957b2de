"""Frames whose metrics can be counted: cars in a row along x, 20 points each unless stated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shift3d.evaluation.frames import DetectedFrame, FrameDetections, GroundTruth

LENGTH_M = 4.0


def cars(*x_m: float, heading: float = 0.0, y: float = 0.0, z: float = 0.8) -> np.ndarray:
    """Return cars 4 m long, 2 m wide and 1.6 m high."""
    return np.array([[x, y, z, LENGTH_M, 2.0, 1.6, heading] for x in x_m], dtype=float).reshape(-1, 7)


def shift_for(iou: float) -> float:
    """Return the shift along x that leaves this IoU of a car with its old place: (4 - s) / (4 + s)."""
    return LENGTH_M * (1.0 - iou) / (1.0 + iou)


def frame(
    truth: np.ndarray,
    found: np.ndarray,
    scores: Sequence[float],
    points: Sequence[int] | None = None,
    counts: Sequence[bool] | None = None,
    difficulty: Sequence[int] | None = None,
    labelled: Sequence[bool] | None = None,
    image_height_px: Sequence[float] | None = None,
    scene: str = "made",
) -> DetectedFrame:
    """Return a frame. Defaults: 20 points, everything counts, no difficulty, no camera."""
    number, boxes = len(truth), len(found)
    return DetectedFrame(
        scene,
        GroundTruth(
            truth,
            np.array([20] * number if points is None else points, dtype=np.int64),
            np.array([True] * number if counts is None else counts, dtype=bool),
            np.array([-1] * number if difficulty is None else difficulty, dtype=np.int64),
            ("Car",) * number,
        ),
        FrameDetections(
            found,
            np.array(scores, dtype=float),
            np.array([True] * boxes if labelled is None else labelled, dtype=bool),
            np.array([np.nan] * boxes if image_height_px is None else image_height_px, dtype=float),
        ),
    )
