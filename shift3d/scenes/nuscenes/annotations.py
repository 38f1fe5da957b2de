"""Boxes of key frames and what is said about their drives."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import count_in_boxes
from shift3d.geometry.rigid import heading_of
from shift3d.scenes.labels import Labels
from shift3d.scenes.nuscenes.tables import indexed, pose_of, table_rows
from shift3d.store.location import Location

_CYCLES = ("vehicle.bicycle", "vehicle.motorcycle")


def class_of(category: str) -> str:
    """The class here of a category's name, such as ``vehicle.car``: two-wheelers count as cyclists."""
    if category in _CYCLES:
        return "cyclist"
    return {"vehicle": "vehicle", "human": "pedestrian"}.get(category.partition(".")[0], "other")


def read_annotations(folder: Location, samples: set[str]) -> dict[str, list[dict[str, Any]]]:
    """Annotations of samples by sample, each with its ``category``; empty where the release has none (test split).

    The category is None where its row or the instance's is missing: `boxes_of` refuses such an annotation.

    Raises InputError: a table is missing or damaged.
    """
    found: dict[str, list[dict[str, Any]]] = {sample: [] for sample in samples}
    for row in table_rows(folder / "sample_annotation.json"):
        if (sample := str(row.get("sample_token"))) in found:
            found[sample].append(row)
    wanted = {str(row.get("instance_token")) for rows in found.values() for row in rows}
    if not wanted:
        return found
    instances = indexed(folder / "instance.json", lambda row: str(row.get("token")) in wanted)
    categories = indexed(folder / "category.json")
    for row in (row for rows in found.values() for row in rows):
        instance = instances.get(str(row.get("instance_token")), {})
        row["category"] = categories.get(str(instance.get("category_token")), {}).get("name")
    return found


def boxes_of(
    rows: list[dict[str, Any]], scene_SE3_global: NDArray[np.float64], points: NDArray[np.float32], where: str
) -> Labels:
    """Boxes in the scene's frame; counts are those of the points (N, 3) given. Raises InputError: a row is no box."""
    boxes = np.zeros((len(rows), 7))
    for index, row in enumerate(rows):
        here = f"{where}, row {row.get('token')}"
        if row["category"] is None:
            raise InputError("it has no category", here, "Copy the release's tables again")
        try:
            width, length, height = (float(edge) for edge in row["size"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError("no size of 3 numbers", here, "Copy it again") from error
        placed = scene_SE3_global @ pose_of(row, here)
        boxes[index] = [*placed[:3, 3], length, width, height, float(heading_of(placed))]
    names = tuple(str(row["category"]) for row in rows)
    return Labels(boxes, tuple(class_of(name) for name in names), count_in_boxes(points, boxes), names)


_RAIN = re.compile(r"\brain(y|ing|s)?\b", re.IGNORECASE)  # neither train nor terrain; "after rain" is rain


def read_weather(folder: Location, samples: set[str]) -> dict[str, str]:
    """ "rain" or "dry" of samples, by the words with which their drives are described.

    Raises InputError: a table is missing or damaged.
    """
    rows = indexed(folder / "sample.json", lambda row: str(row.get("token")) in samples)
    drives = indexed(folder / "scene.json")
    descriptions = {
        name: str(drives.get(str(row.get("scene_token")), {}).get("description", "")) for name, row in rows.items()
    }
    return {name: "rain" if _RAIN.search(descriptions.get(name, "")) else "dry" for name in samples}
