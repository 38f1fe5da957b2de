"""Objects on the street's ground, and the floor plan that they occupy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.geometry.boxes import corners_bev

OWN_CAR_M = (-0.8, 0.0, 6.0, 2.4)  # x, y of its centre, length and width: the LiDAR is ahead of its centre
Size = tuple[float, float, float]
LABELLED = ("vehicle", "pedestrian", "cyclist")


@dataclass(frozen=True)
class Item:
    """One object.

    Attributes:
        kind: "vehicle", "pedestrian", "cyclist", "building", "pole", "sign", "tree", "wall", "hedge", "fence",
            "thicket", "bush", "dumpster", "container", "cabinet", "barrier".
        x, y: scene frame, metres; heading_rad counter-clockwise from +x.
        size_m: length, width, height; for a vehicle the reserved slot.
        variant: selects the instance and its details.
    """

    kind: str
    x: float
    y: float
    heading_rad: float
    size_m: Size
    variant: int = 0

    def to_scene(self, along: Any, across: Any) -> tuple[Any, Any]:
        """Convert offsets ahead and to the left of the item's centre, numbers or arrays, metres, to scene (x, y)."""
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return self.x + cos * along - sin * across, self.y + sin * along + cos * across


class FloorPlan:
    """Occupied floor space: the rectangles of the items placed so far.

    slot_m: length, width and height reserved for the vehicle of a variant, metres.
    """

    def __init__(self, slot_m: Callable[[int], Size]) -> None:
        self.items: list[Item] = []
        self.slot_m = slot_m
        self._corners = np.zeros((0, 4, 2))

    def place(self, item: Item, margin_m: float = 0.2) -> bool:
        """Add an item unless its floor rectangle, grown by the margin, overlaps another. Returns True if added."""
        length, width, _ = item.size_m
        grown = _floor(item.x, item.y, length + 2 * margin_m, width + 2 * margin_m, item.heading_rad)
        if _meets(grown[0], self._corners).any():
            return False
        self.reserve(item.x, item.y, item.heading_rad, length, width)
        self.items.append(item)
        return True

    def reserve(self, x: float, y: float, heading_rad: float, length_m: float, width_m: float) -> None:
        """Reserve a rectangle without an item (the sensor's own car, a driveway)."""
        self._corners = np.concatenate((self._corners, _floor(x, y, length_m, width_m, heading_rad)))


def items_overlapping(
    items: tuple[Item, ...], x: float, y: float, length_m: float, width_m: float
) -> NDArray[np.bool_]:
    """Mark the items (items,) whose floor rectangle overlaps an axis-aligned rectangle centred at scene (x, y)."""
    floors = np.array([[item.x, item.y, 0.0, *item.size_m, item.heading_rad] for item in items]).reshape(-1, 7)
    return _meets(_floor(x, y, length_m, width_m, 0.0)[0], corners_bev(floors))


def _floor(x: float, y: float, length_m: float, width_m: float, heading_rad: float) -> NDArray[np.float64]:
    """Return the corners (1, 4, 2) of a floor rectangle."""
    return corners_bev(np.array([[x, y, 0.0, length_m, width_m, 1.0, heading_rad]]))


def _meets(one: NDArray[np.float64], many: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Test a rectangle (4, 2) against rectangles (N, 4, 2) by separating axes."""
    if not len(many):
        return np.zeros(0, dtype=np.bool_)
    apart = np.zeros(len(many), dtype=np.bool_)
    for corners in (np.broadcast_to(one, many.shape), many):
        for edge in (1, 3):
            axis = corners[:, edge] - corners[:, 0]
            a = np.einsum("nij,nj->ni", np.broadcast_to(one, many.shape), axis)
            b = np.einsum("nij,nj->ni", many, axis)
            apart |= (a.max(1) <= b.min(1)) | (b.max(1) <= a.min(1))
    return ~apart
