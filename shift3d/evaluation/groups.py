"""Groups of vehicles that a detector's quality is broken down by."""

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
    """Of boxes (M, 7), sensor at the origin: which side the beam to the centre meets, within 22.5 degrees."""
    turn = boxes[:, 6] - np.arctan2(boxes[:, 1], boxes[:, 0])
    away = np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi)
    near = np.pi / 8
    names = np.where(away <= near, "rear", np.where(away >= np.pi - near, "front", "oblique"))
    return tuple(np.where(np.abs(away - np.pi / 2) <= near, "side", names).tolist())


@dataclass(frozen=True)
class Group:
    """Some of the vehicles.

    by: "all", "range", "heading", "points", "body" or "attribute"; name: which. low <= range or number of points <
    high, where it is by these.
    """

    by: str
    name: str
    low: float = 0.0
    high: float = np.inf

    @property
    def range_m(self) -> tuple[float, float]:
        """Ranges of the vehicles and of the detections that take part."""
        return (self.low, self.high) if self.by == "range" else (0.0, MAX_RANGE_M)

    def members(self, boxes: Floats, num_points: Ints, kinds: Sequence[str]) -> Flags:
        """(M,) bool: which vehicles belong to it. kinds: M of them, or none at all."""
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
    """All, then by range, heading, points, and what the kinds say: a body type and, after each +, what it carries."""
    groups = [Group("all", "all")]
    groups += [Group("range", f"{low:g}-{high:g} m", low, high) for low, high in RANGE_BINS_M]
    groups += [Group("heading", name) for name in ASPECTS]
    for low, high in POINT_BINS:
        groups.append(Group("points", f"{low:g} or more" if np.isinf(high) else f"{low:g}-{high - 1:g}", low, high))
    groups += [Group("body", body) for body in sorted({kind.split("+")[0] for kind in kinds if kind})]
    parts = sorted({part for kind in kinds for part in kind.split("+")[1:]})
    return groups + [Group("attribute", part) for part in ([PLAIN, *parts] if parts else [])]
