"""Groups of vehicles for the breakdown of detector metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shift3d.evaluation.frames import Flags, Floats, Ints, range_of

MAX_RANGE_M = 75.0
RANGE_BINS_M = ((0.0, 30.0), (30.0, 50.0), (50.0, MAX_RANGE_M))
ASPECTS = ("front", "side", "rear", "oblique")
POINT_BINS = ((6.0, 20.0), (20.0, 100.0), (100.0, 500.0), (500.0, np.inf))
PLAIN = "none"


def aspect(boxes: Floats) -> tuple[str, ...]:
    """Return the side of each box (M, 7) that faces the sensor at the origin within 22.5 degrees, else "oblique"."""
    turn = boxes[:, 6] - np.arctan2(boxes[:, 1], boxes[:, 0])
    away = np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi)
    near = np.pi / 8
    names = np.where(away <= near, "rear", np.where(away >= np.pi - near, "front", "oblique"))
    return tuple(np.where(np.abs(away - np.pi / 2) <= near, "side", names).tolist())


@dataclass(frozen=True)
class Group:
    """Group of vehicles.

    by: "all", "range", "heading", "points", "body" or "attribute"; name: of the group. low, high: half-open interval
    [low, high) of the range or the number of points.
    """

    by: str
    name: str
    low: float = 0.0
    high: float = np.inf

    @property
    def range_m(self) -> tuple[float, float]:
        """Range interval of the vehicles and detections of the group."""
        return (self.low, self.high) if self.by == "range" else (0.0, MAX_RANGE_M)

    def members(self, boxes: Floats, num_points: Ints, kinds: Sequence[str]) -> Flags:
        """Return the mask (M,) bool of the vehicles in the group. kinds: M kinds, or empty."""
        if self.by in ("all", "range"):
            distance = range_of(boxes)
            return np.asarray((distance >= self.range_m[0]) & (distance < self.range_m[1]))
        if self.by == "points":
            return np.asarray((num_points >= self.low) & (num_points < self.high))
        if self.by == "heading":
            return np.array([own == self.name for own in aspect(boxes)], dtype=bool)
        return np.array([self._is_of_kind(kind) for kind in kinds or ("",) * len(boxes)], dtype=bool)

    def _is_of_kind(self, kind: str) -> bool:
        body, *parts = kind.split("+")
        if self.by == "body":
            return body == self.name
        return self.name in parts or (self.name == PLAIN and bool(kind) and not parts)


def groups_of(kinds: Sequence[str]) -> list[Group]:
    """Return all groups: all, by range, heading and points, and by the body types and attributes ("+...") of kinds."""
    groups = [Group("all", "all")]
    groups += [Group("range", f"{low:g}-{high:g} m", low, high) for low, high in RANGE_BINS_M]
    groups += [Group("heading", name) for name in ASPECTS]
    for low, high in POINT_BINS:
        groups.append(Group("points", f"{low:g} or more" if np.isinf(high) else f"{low:g}-{high - 1:g}", low, high))
    groups += [Group("body", body) for body in sorted({kind.split("+")[0] for kind in kinds if kind})]
    parts = sorted({part for kind in kinds for part in kind.split("+")[1:]})
    return groups + [Group("attribute", part) for part in ([PLAIN, *parts] if parts else [])]
