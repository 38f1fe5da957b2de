"""Boxes of a frame and statements about its segment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import count_in_boxes
from shift3d.scenes.labels import Labels
from shift3d.scenes.waymo.frame import component_file
from shift3d.scenes.waymo.tables import by_key
from shift3d.store.location import Location

CLASSES = {1: ("VEHICLE", "vehicle"), 2: ("PEDESTRIAN", "pedestrian"), 3: ("SIGN", "other"), 4: ("CYCLIST", "cyclist")}
"""Types of boxes by number: the data set's name and the class here."""
_OBJECT = "key.laser_object_id"
_BOX = "[LiDARBoxComponent].box"
_FIELDS = tuple(
    f"{_BOX}.{part}" for part in ("center.x", "center.y", "center.z", "size.x", "size.y", "size.z", "heading")
)
_TYPE = "[LiDARBoxComponent].type"
_WEATHER = "[StatsComponent].weather"


def read_labels(
    root: Location, segment: str, timestamp: int, points: NDArray[np.float32], offset: NDArray[np.float64]
) -> Labels:
    """Boxes of a frame (none is a valid answer), in the order of the file; counts are those of the points given.

    Args:
        points: (N, 3) scene frame. offset: (3,) of the scene's origin in the vehicle frame, metres.

    Raises InputError: the component is missing, unreadable or without rows; an object twice; an unknown type.
    """
    component = component_file(root, "lidar_box", segment)
    table = component.rows([_OBJECT, *_FIELDS, _TYPE], timestamp)
    rows = list(by_key(table, _OBJECT, f"{component.file}, frame {timestamp}").items())
    boxes, types = np.zeros((len(rows), 7)), []
    for index, (name, row) in enumerate(rows):
        where = f"{component.file}, frame {timestamp}, object {name}"
        values = [row[field].as_py() for field in _FIELDS]
        kind = row[_TYPE].as_py()
        if kind not in CLASSES:
            raise InputError(f"unknown type {kind!r}", where, f"Known: {', '.join(map(str, CLASSES))}")
        if any(value is None for value in values):
            raise InputError("a box without a number", where, "Copy the component again")
        boxes[index] = values
        types.append(CLASSES[kind])
    boxes[:, :3] -= offset
    names, classes = tuple(name for name, _ in types), tuple(kind for _, kind in types)
    return Labels(boxes, classes, count_in_boxes(points, boxes), names)


def read_weather(root: Location, segment: str, timestamp: int) -> str:
    """ "rain" or "dry", as the segment's statistics have it; dry where they say nothing of this frame.

    Raises InputError: the component is missing, unreadable or without rows.
    """
    rows = component_file(root, "stats", segment).rows([_WEATHER], timestamp)
    return "rain" if "rain" in {str(word).lower() for word in rows[_WEATHER].to_pylist()} else "dry"
