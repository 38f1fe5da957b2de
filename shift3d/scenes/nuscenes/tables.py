"""The tables of a release: read row by row, what is needed is kept."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import from_quaternion
from shift3d.store.location import Location

_SENSOR = "LIDAR_TOP"
_PIECE = 2**20
_AGAIN = "Copy it again"
Row = dict[str, Any]


def table_rows(file: Location) -> Iterator[Row]:
    """Rows of a table, a JSON array of objects, without holding the file: the largest have a gigabyte.

    Raises InputError: the file is missing, cut short, or something else.
    """
    decoder, text = json.JSONDecoder(), ""
    try:
        with contextlib.closing(file.open()) as handle, io.TextIOWrapper(handle, "utf-8") as reader:
            while piece := reader.read(_PIECE):
                text += piece
                at = 0
                while True:
                    at = _next(text, at)
                    if text[at : at + 1] == "]":
                        return
                    try:
                        row, at = decoder.raw_decode(text, at)
                    except ValueError:  # the rest of the row is not here yet
                        break
                    if not isinstance(row, dict):
                        raise InputError(f"a row is {str(row)[:40]!r}, not an object", str(file), _AGAIN)
                    yield row
                text = text[at:]
    except FileNotFoundError as error:
        raise InputError("the table is missing", str(file), "Copy the release's tables again") from error
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"not a readable table ({str(error)[:80]})", str(file), _AGAIN) from error
    raise InputError("the table is cut short, or is no JSON array", str(file), _AGAIN)


def _next(text: str, at: int) -> int:
    """Where the next row, or the end of the array, begins."""
    while at < len(text) and text[at] in " \t\r\n,[":
        at += 1
    return at


def indexed(file: Location, keep: Callable[[Row], bool] = lambda row: True) -> dict[str, Row]:
    """Rows of a table by their token. Raises InputError: as `table_rows`; a row lacks it; no rows at all."""
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
    """One sweep of the LiDAR: its file below the root, when it was taken, and where the sensor was."""

    sample: str
    filename: str
    time_us: int
    previous: str
    pose: str
    mount: str


@dataclass
class Release:
    """The tables of one version, kept as far as LIDAR_TOP needs them.

    lidar: its files by token, key frames and those between. key_frames: token of a key frame's file by its sample, in
    order of time within each drive.
    """

    folder: Location
    lidar: dict[str, LidarFile]
    key_frames: dict[str, str]

    @staticmethod
    def read(folder: Location) -> Release:
        """Read what scenes are listed by. Raises InputError: a table is missing, damaged, or without such rows."""
        file = folder / "sample_data.json"
        lidar, key_frames = {}, []
        for token, row in indexed(file, lambda row: f"/{_SENSOR}/" in str(row.get("filename"))).items():
            found = LidarFile(
                str(_of(row, "sample_token", file)),
                str(_of(row, "filename", file)),
                _time_us(row, file),
                str(_of(row, "prev", file)),
                str(_of(row, "ego_pose_token", file)),
                str(_of(row, "calibrated_sensor_token", file)),
            )
            lidar[token] = found
            if _of(row, "is_key_frame", file):
                key_frames.append((found.time_us, found.sample, token))
        return Release(folder, lidar, {sample: token for _, sample, token in sorted(key_frames)})

    def poses(self, table: str, tokens: set[str]) -> Poses:
        """Poses by token. Raises InputError: as `indexed`."""
        file = self.folder / f"{table}.json"
        return Poses(file, indexed(file, lambda row: str(row.get("token")) in tokens))


@dataclass(frozen=True)
class Poses:
    """Rows of a table with translation and rotation, by token; a row that is no pose is refused when it is used."""

    file: Location
    rows: Mapping[str, Row]

    def __getitem__(self, token: str) -> NDArray[np.float64]:
        """(4, 4), metres. Raises InputError: there is no such row, or it is no pose."""
        if token not in self.rows:
            raise InputError(f"no row {token}", str(self.file), "Copy the release's tables again")
        return pose_of(self.rows[token], f"{self.file}, row {token}")


def pose_of(row: Mapping[str, Any], where: str) -> NDArray[np.float64]:
    """(4, 4) of a row's translation and rotation (w, x, y, z). Raises InputError: they are none."""
    try:
        rotation, translation = (np.array(row[name], dtype=np.float64) for name in ("rotation", "translation"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError("no rotation and translation", where, _AGAIN) from error
    if rotation.shape != (4,) or translation.shape != (3,):
        raise InputError("no rotation and translation", where, _AGAIN)
    return from_quaternion(rotation, translation, where)


def _time_us(row: Row, file: Location) -> int:
    value = _of(row, "timestamp", file)
    try:
        return int(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"row {row.get('token')} has timestamp {str(value)[:40]}", str(file), _AGAIN) from error


def _of(row: Row, name: str, file: Location) -> Any:
    if name not in row:
        raise InputError(f"row {row.get('token')} has no {name}", str(file), _AGAIN)
    return row[name]
