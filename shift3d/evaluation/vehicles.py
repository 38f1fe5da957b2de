"""Per-vehicle table of the matched detection and its errors in position, size and heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from shift3d.evaluation.frames import DetectedFrame, Flags, Floats, Ints, compare, range_of
from shift3d.evaluation.groups import aspect
from shift3d.geometry.iou import iou_3d

MATCH_IOU = 0.5
"""Least bird's-eye IoU of a detection and its matched vehicle: lenient, so that large errors stay visible."""
MATCH_SCORE = 0.3
"""Least score of a match that counts as found."""
ERRORS = ("x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad")
"""Errors, detected minus true. x, y: along and across the true vehicle. heading: of the axis, modulo half turns."""


@dataclass(frozen=True)
class VehicleRows:
    """All vehicles that count in all frames, in the order of frames and labels; (V,) each.

    frame, row: index of the frame and of the label. boxes: (V, 7), scene frame. aspect: side of the vehicle that the
    beam from the sensor hits: "rear", "front", "side", "oblique". kind: "" if labels have none. score: of the match,
    NaN without a match. iou_bev, iou_3d: with the match, 0 without a match. flipped: True if the heading of the match
    differs by more than a quarter turn. errors: (V, 7), see ERRORS, NaN without a match.
    """

    frame: Ints
    row: Ints
    boxes: Floats
    num_points: Ints
    aspect: tuple[str, ...]
    kind: tuple[str, ...]
    score: Floats
    iou_bev: Floats
    iou_3d: Floats
    flipped: Flags
    errors: Floats

    @property
    def range_m(self) -> Floats:
        """(V,) horizontal distance of the centres from the sensor."""
        return range_of(self.boxes)

    @property
    def matched(self) -> Flags:
        """Mask (V,) bool of vehicles with a match of at least MATCH_SCORE."""
        return np.asarray(self.score >= MATCH_SCORE)


def vehicle_rows(frames: Sequence[DetectedFrame]) -> VehicleRows:
    """Match each detection, highest score first, to the unmatched vehicle with the largest bird's-eye overlap.

    Source: greedy matching as in nuScenes, but by overlap instead of distance (our choice).
    """
    parts = [_of_frame(index, frame) for index, frame in enumerate(frames)]
    columns: dict[str, Any] = {
        name: tuple(text for part in parts for text in getattr(part, name)) for name in ("aspect", "kind")
    }
    numbers = [field.name for field in fields(VehicleRows) if field.name not in columns]
    columns |= {name: np.concatenate([getattr(part, name) for part in parts]) for name in numbers}
    return VehicleRows(**columns)


def _of_frame(index: int, frame: DetectedFrame) -> VehicleRows:
    comparison = compare(frame, "BEV")
    truth, found = comparison.truth, comparison.found
    match = np.full(len(truth.boxes), -1)
    for number in range(len(found.scores)):
        overlap = np.where(match < 0, comparison.overlap[number], 0.0)
        if overlap.size and overlap.max() >= MATCH_IOU:
            match[int(overlap.argmax())] = number
    kept = np.flatnonzero(truth.counts & (truth.num_points >= 1))
    boxes, has = truth.boxes[kept], match[kept] >= 0
    matched = match[kept[has]]
    score, errors = np.full(len(kept), np.nan), np.full((len(kept), 7), np.nan)
    area, volume, flipped = np.zeros(len(kept)), np.zeros(len(kept)), np.zeros(len(kept), dtype=bool)
    score[has], area[has] = found.scores[matched], comparison.overlap[matched, kept[has]]
    volume[has] = np.diagonal(iou_3d(found.boxes[matched], boxes[has]))
    errors[has], flipped[has] = _errors(boxes[has], found.boxes[matched])
    return VehicleRows(
        np.full(len(kept), index, dtype=np.int64),
        kept.astype(np.int64),
        boxes,
        truth.num_points[kept],
        aspect(boxes),
        tuple(truth.kinds[row] for row in kept) if truth.kinds else ("",) * len(kept),
        score,
        area,
        volume,
        flipped,
        errors,
    )


def _errors(truth: Floats, found: Floats) -> tuple[Floats, Flags]:
    """Compute errors (M, 7) of paired boxes, and the mask (M,) of headings that differ by more than a quarter turn."""
    offset, cos, sin = found[:, :2] - truth[:, :2], np.cos(truth[:, 6]), np.sin(truth[:, 6])
    along, across = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
    turn = np.mod(found[:, 6] - truth[:, 6] + np.pi, 2 * np.pi) - np.pi
    axis = np.mod(turn + np.pi / 2, np.pi) - np.pi / 2
    rest = found[:, 2:6] - truth[:, 2:6]
    return np.column_stack((along, across, rest, axis)), np.asarray(np.abs(turn) > np.pi / 2)
