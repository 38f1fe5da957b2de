"""Tables of a release, read row by row without holding unneeded rows; poses, boxes and weather from them."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import from_quaternion, heading_of
from shift3d.scenes.file_checks import opened
from shift3d.scenes.scene import Labels
from shift3d.store.location import Location

_SENSOR = "LIDAR_TOP"
_PIECE = 2**20
_AGAIN = "Copy it again"
Row = dict[str, Any]
_TEXTS = ("sample_token", "filename", "prev", "ego_pose_token", "calibrated_sensor_token")


def table_rows(file: Location) -> Iterator[Row]:
    """Read the rows of a table, a JSON array of objects, as a stream: the largest tables have a gigabyte.

    Raises InputError: the file is missing, cut short, or something else.
    """
    decoder, text = json.JSONDecoder(), ""
    with (
        opened(file, "table", RecursionError) as handle,
        io.TextIOWrapper(handle, "utf-8") as reader,
    ):
        while piece := reader.read(_PIECE):
            text += piece
            at = 0
            while True:
                at = _next(text, at)
                if text[at : at + 1] == "]":
                    return
                try:
                    row, at = decoder.raw_decode(text, at)
                except ValueError:  # the rest of the row is not read yet
                    break
                if not isinstance(row, dict):
                    raise InputError(f"a row is {str(row)[:40]!r}, not an object", str(file), _AGAIN)
                yield row
            text = text[at:]
    raise InputError("the table is cut short, or is no JSON array", str(file), _AGAIN)


def _next(text: str, at: int) -> int:
    """Find the start of the next row, or the end of the array."""
    while at < len(text) and text[at] in " \t\r\n,[":
        at += 1
    return at


def indexed(file: Location, keep: Callable[[Row], bool] = lambda row: True) -> dict[str, Row]:
    """Index the rows of a table by token. Raises InputError: as `table_rows`; a row without token; no rows at all."""
    found, rows = {}, 0
    for rows, row in enumerate(table_rows(file), start=1):
        if "token" not in row:
            raise InputError(f"row {rows} has no token", str(file), _AGAIN)
        if keep(row):
            found[str(row["token"])] = row
    if not rows:
        raise InputError("the table has no rows", str(file), _AGAIN)
    return found


@dataclass(frozen=True)
class LidarFile:
    """One sweep of the LiDAR: file below the root, time, and tokens of its sample, poses and previous sweep."""

    sample: str
    filename: str
    previous: str
    pose: str
    mount: str
    time_us: int


@dataclass
class Release:
    """Tables of one version, restricted to LIDAR_TOP.

    lidar: files by token, with sweeps between key frames. key_frames: file token by sample, in order of time.
    """

    folder: Location
    lidar: dict[str, LidarFile]
    key_frames: dict[str, str]

    @staticmethod
    def read(folder: Location) -> Release:
        """Read the list of scenes. Raises InputError: a table is missing or damaged, or a row lacks a field."""
        file = folder / "sample_data.json"
        lidar, key_frames = {}, []
        for token, row in indexed(file, lambda row: f"/{_SENSOR}/" in str(row.get("filename"))).items():
            if missing := [name for name in (*_TEXTS, "is_key_frame", "timestamp") if name not in row]:
                raise InputError(f"row {token} has no {missing[0]}", str(file), _AGAIN)
            sample, filename, previous, pose, mount = (str(row[name]) for name in _TEXTS)
            found = LidarFile(sample, filename, previous, pose, mount, _time_us(row, file))
            lidar[token] = found
            if row["is_key_frame"]:
                key_frames.append((found.time_us, found.sample, token))
        return Release(folder, lidar, {sample: token for _, sample, token in sorted(key_frames)})

    def poses(self, table: str, tokens: set[str]) -> Poses:
        """Read poses by token. Raises InputError: as `indexed`."""
        file = self.folder / f"{table}.json"
        return Poses(file, indexed(file, lambda row: str(row.get("token")) in tokens))


@dataclass(frozen=True)
class Poses:
    """Rows of a table with translation and rotation, by token; a bad row raises its error at the first use."""

    file: Location
    rows: Mapping[str, Row]

    def __getitem__(self, token: str) -> NDArray[np.float64]:
        """Return the pose (4, 4), metres. Raises InputError: the row is missing, or is no pose."""
        if token not in self.rows:
            raise InputError(f"no row {token}", str(self.file), "Copy the release's tables again")
        return pose_of(self.rows[token], f"{self.file}, row {token}")


def pose_of(row: Mapping[str, Any], where: str) -> NDArray[np.float64]:
    """Convert a row's translation and rotation (w, x, y, z) to a pose (4, 4). Raises InputError: they are no pose."""
    try:
        rotation, translation = (np.array(row[name], dtype=np.float64) for name in ("rotation", "translation"))
        if rotation.shape != (4,) or translation.shape != (3,):
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError("no rotation and translation", where, _AGAIN) from error
    return from_quaternion(rotation, translation, where)


def _time_us(row: Row, file: Location) -> int:
    value = row["timestamp"]
    try:
        return int(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"row {row.get('token')} has timestamp {str(value)[:40]}", str(file), _AGAIN) from error


_CYCLES = ("vehicle.bicycle", "vehicle.motorcycle")


def class_of(category: str) -> str:
    """Map a category such as ``vehicle.car`` to a shift3d class; two-wheelers count as cyclists."""
    if category in _CYCLES:
        return "cyclist"
    return {"vehicle": "vehicle", "human": "pedestrian"}.get(category.partition(".")[0], "other")


def read_annotations(folder: Location, samples: set[str]) -> dict[str, list[dict[str, Any]]]:
    """Read the annotations by sample, each with its ``category``; empty if the release has none (test split).

    The category is None if its row or the instance's row is missing: `boxes_of` refuses that annotation.

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
    """Convert annotations to boxes, scene frame, and count points (N, 3) inside. Raises InputError: a row is no box."""
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
    return Labels.of_file(boxes, tuple(class_of(name) for name in names), names, points, where)


_RAIN = re.compile(r"\brain(y|ing|s)?\b", re.IGNORECASE)  # neither train nor terrain; "after rain" is rain


def read_weather(folder: Location, samples: set[str]) -> dict[str, str]:
    """Read the weather of samples, "rain" or "dry", from the descriptions of their drives.

    Raises InputError: a table is missing or damaged.
    """
    rows = indexed(folder / "sample.json", lambda row: str(row.get("token")) in samples)
    drives, found = indexed(folder / "scene.json"), {}
    for name in samples:
        drive = drives.get(str(rows.get(name, {}).get("scene_token")), {})
        found[name] = "rain" if _RAIN.search(str(drive.get("description", ""))) else "dry"
    return found
