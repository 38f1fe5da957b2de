"""Reader of one frame of a segment: rows of each laser joined by all their keys, boxes and weather."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import validate_rigid
from shift3d.scenes.scene import Labels
from shift3d.scenes.waymo.range_image import LaserCalibration, filled_poses, vehicle_beams, vehicle_SE3_pixels
from shift3d.scenes.waymo.tables import FRAME, LASER, SEGMENT, Component, by_key, numbers
from shift3d.store.location import Location

Float = NDArray[np.float64]

LASERS = {"TOP": 1, "FRONT": 2, "SIDE_LEFT": 3, "SIDE_RIGHT": 4, "REAR": 5}
"""Lasers by name, with their number in `key.laser_name`."""
_TOP = LASERS["TOP"]
_IMAGES = tuple(f"[LiDARComponent].range_image_return{number}" for number in (1, 2))
_POSES = "[LiDARPoseComponent].range_image_return1"
_EXTRINSIC = "[LiDARCalibrationComponent].extrinsic.transform"
_INCLINATION = "[LiDARCalibrationComponent].beam_inclination"
_VEHICLE = "[VehiclePoseComponent].world_from_vehicle.transform"
_PAIR = "Pair components of one segment: copy both again"


@dataclass(frozen=True)
class LaserFrame:
    """Data of one laser in one frame.

    Attributes:
        images: first and second returns, (H, W, 4) float32: range, metres (not positive: none), intensity, elongation,
            and 1 in a no-label zone.
        origins, directions: (H, W, 3) float64 of each pixel's beam, vehicle frame.
    """

    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    origins: Float
    directions: Float


def component_file(root: Location, component: str, segment: str) -> Component:
    """Return a component of a segment below the root; the file need not exist."""
    return Component(root / component / f"{segment}.parquet", segment)


def read_frame(root: Location, segment: str, timestamp: int, lasers: Sequence[str]) -> list[LaserFrame]:
    """Read a frame of each of the lasers, in the order of their numbers.

    Raises InputError: a component is missing or unreadable; a laser has no row, or two, in a component; the images of a
    laser differ in size, or have a range that is not finite.
    """
    lidar = component_file(root, "lidar", segment)
    columns = [LASER, *(f"{image}.{part}" for image in _IMAGES for part in ("values", "shape"))]
    rows = _by_laser(lidar, columns, timestamp)
    chosen, frames = sorted(LASERS[name] for name in lasers), []
    calibrations = read_calibrations(root, segment, chosen)
    for number in chosen:
        where = f"{lidar.file}, laser {number} at {timestamp}"
        first, second = (_image(_row(rows, number, lidar, timestamp), name, 4, where) for name in _IMAGES)
        if first.shape != second.shape:
            raise InputError(f"range images of {first.shape} and {second.shape} for its two returns", where, _PAIR)
        if not np.isfinite([first[..., 0], second[..., 0]]).all():
            raise InputError("a range that is not finite", where, "Copy the component again")
        shape = (first.shape[0], first.shape[1])
        pixels = _pixels(root, segment, timestamp, shape) if number == _TOP else None
        origins, directions = vehicle_beams(calibrations[number], shape, pixels, where)
        frames.append(LaserFrame((first, second), origins, directions))
    return frames


def read_calibrations(root: Location, segment: str, wanted: Sequence[int]) -> dict[int, LaserCalibration]:
    """Read the calibrations of the lasers by number.

    Raises InputError: the component is missing or unreadable, has a laser twice, or lacks a wanted laser.
    """
    component = component_file(root, "lidar_calibration", segment)
    columns = [LASER, _EXTRINSIC, *(f"{_INCLINATION}.{part}" for part in ("min", "max", "values"))]
    found = {}
    for number, row in _by_laser(component, columns, None).items():
        where = f"{component.file}, laser {number}"
        extrinsic = numbers(row[_EXTRINSIC], 16, where).reshape(4, 4)
        validate_rigid(extrinsic, where)
        beams = row[f"{_INCLINATION}.values"]
        low, high = (row[f"{_INCLINATION}.{part}"].as_py() for part in ("min", "max"))
        has_table = beams.is_valid and len(beams.values) > 0
        if not has_table and (low is None or high is None):
            raise InputError("neither beam inclinations nor their limits", where, "Copy the component again")
        limits = (float("nan") if low is None else float(low), float("nan") if high is None else float(high))
        found[number] = LaserCalibration(extrinsic, limits, numbers(beams, None, where) if has_table else None)
    if missing := [number for number in wanted if number not in found]:
        raise InputError(f"no row of laser {missing[0]}", str(component.file), _PAIR)
    return found


def read_vehicle_pose(root: Location, segment: str, timestamp: int) -> Float:
    """Read global_SE3_vehicle (4, 4) of a frame. Raises InputError: no row, or several, for the frame."""
    component = component_file(root, "vehicle_pose", segment)
    rows = by_key(component.rows([_VEHICLE], timestamp), FRAME, str(component.file))
    if timestamp not in rows:
        raise InputError(f"no row of frame {timestamp}", str(component.file), _PAIR)
    where = f"{component.file}, frame {timestamp}"
    pose = numbers(rows[timestamp][_VEHICLE], 16, where).reshape(4, 4)
    validate_rigid(pose, where)
    return pose


def _pixels(root: Location, segment: str, timestamp: int, shape: tuple[int, int]) -> Float:
    component = component_file(root, "lidar_pose", segment)
    rows = _by_laser(component, [LASER, f"{_POSES}.values", f"{_POSES}.shape"], timestamp)
    where = f"{component.file}, laser {_TOP} at {timestamp}"
    poses = _image(_row(rows, _TOP, component, timestamp), _POSES, 6, where)
    if poses.shape[:2] != shape:
        raise InputError(f"poses of {poses.shape[:2]} pixels for a range image of {shape}", where, _PAIR)
    return vehicle_SE3_pixels(filled_poses(poses, where), read_vehicle_pose(root, segment, timestamp))


def _by_laser(component: Component, columns: Sequence[str], timestamp: int | None) -> dict[int, dict[str, Any]]:
    """Index rows by the laser's number; some published samples store the laser's name instead."""
    rows = by_key(component.rows(columns, timestamp), LASER, str(component.file))
    found = {}
    for key, row in rows.items():
        number = LASERS.get(key) if isinstance(key, str) else key
        if not isinstance(number, int) or number not in LASERS.values():
            raise InputError(f"unknown laser {key!r}", str(component.file), f"Write one of {', '.join(LASERS)}, 1 to 5")
        found[number] = row
    return found


def _row(rows: Mapping[int, dict[str, Any]], number: int, component: Component, timestamp: int) -> dict[str, Any]:
    if number not in rows:
        what = f"no row with {SEGMENT}={component.segment}, {FRAME}={timestamp}, {LASER}={number}"
        raise InputError(what, str(component.file), _PAIR)
    return rows[number]


def _image(row: Mapping[str, Any], name: str, channels: int, where: str) -> NDArray[np.float32]:
    """Reshape a flat list to (H, W, channels) float32."""
    edges, values = numbers(row[f"{name}.shape"], 3, where), row[f"{name}.values"]
    if not (edges[2] == channels and 1.0 <= edges.min() <= edges.max() < np.inf):  # a gap in the list is NaN
        found = ", ".join(f"{edge:g}" for edge in edges)
        raise InputError(f"{name} has shape [{found}], not (H, W, {channels})", where, "Copy the component again")
    shape = [int(edge) for edge in edges]
    flat = numbers(values, shape[0] * shape[1] * shape[2], f"{where}, {name}")
    return flat.astype(np.float32).reshape(shape)


CLASSES = {1: ("VEHICLE", "vehicle"), 2: ("PEDESTRIAN", "pedestrian"), 3: ("SIGN", "other"), 4: ("CYCLIST", "cyclist")}
"""Types of boxes by number: name in the data set, and shift3d class."""
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
    """Read the boxes of a frame (possibly none), in the order of the file, and count the given points.

    Args:
        points: (N, 3) scene frame. offset: (3,) scene origin in the vehicle frame, metres.

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
            raise InputError(f"unknown type {kind!r}", where, f"Write one of {', '.join(map(str, CLASSES))}")
        if any(value is None for value in values):
            raise InputError("a box without a number", where, "Copy the component again")
        boxes[index] = values
        types.append(CLASSES[kind])
    boxes[:, :3] -= offset
    names, classes = tuple(name for name, _ in types), tuple(kind for _, kind in types)
    return Labels.of_file(boxes, classes, names, points, f"{component.file}, frame {timestamp}")


def read_weather(root: Location, segment: str, timestamp: int) -> str:
    """Read "rain" or "dry" from the segment's statistics; dry if they do not list this frame.

    Raises InputError: the component is missing, unreadable or without rows.
    """
    rows = component_file(root, "stats", segment).rows([_WEATHER], timestamp)
    return "rain" if "rain" in {str(word).lower() for word in rows[_WEATHER].to_pylist()} else "dry"
