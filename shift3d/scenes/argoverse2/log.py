"""Files of one log: sweeps, poses, calibration, annotations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import from_quaternion, heading_of, interpolate_poses, inverse
from shift3d.scenes.file_checks import opened, stems_in
from shift3d.scenes.scene import Labels
from shift3d.store.location import Location

Float = NDArray[np.float64]

_AGAIN = "Copy it again"
_POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


def feather_table(file: Location, columns: Sequence[str]) -> pa.Table:
    """Read some columns of a Feather file; other columns are not read.

    Raises InputError: the file is missing, no Feather file or cut short, lacks a column, or has no rows.
    """
    with opened(file, "Feather file", pa.ArrowException) as handle:
        missing = sorted(set(columns) - set(pa.ipc.open_file(handle).schema.names))
        if missing:
            raise InputError(f"no column {missing[0]}", str(file), "Give the data set's own file")
        handle.seek(0)
        table = feather.read_table(handle, columns=list(columns), memory_map=False, use_threads=False)
        table.validate(full=True)  # its texts may not be UTF-8
    if not table.num_rows:
        raise InputError("the table has no rows", str(file), f"{_AGAIN}, or leave it out")
    return table


def column(table: pa.Table, name: str, dtype: type[np.generic], file: Location) -> NDArray[Any]:
    """Return one numeric column (rows,), cast to a dtype.

    Raises InputError: it is not numeric, has gaps, or holds a value that is no integer where the dtype is one. Floats
    so large that they merge two integers (nanoseconds since 1970 in float64) are none.
    """
    found = table[name]
    number = pa.types.is_integer(found.type) or pa.types.is_floating(found.type)
    if found.null_count or not number:
        raise InputError(f"column {name} has gaps or is no numbers", str(file), _AGAIN)
    values: NDArray[Any] = found.to_numpy()
    floats = pa.types.is_floating(found.type)
    exact = 2.0 ** (np.finfo(values.dtype).nmant + 1) if floats else 2.0**63
    # A NaN compares false. Fractions are truncated: a firing time in another unit has its own error.
    if np.issubdtype(dtype, np.integer) and not (np.abs(values) < exact).all():
        what = f"column {name} has values that are NaN or no integers of 64 bits"
        kind = f", as its type {values.dtype} is exact up to {exact:.0e} only" if floats else ""
        raise InputError(what + kind, str(file), f"{_AGAIN}, or write int64")
    return values.astype(dtype)


def poses(table: pa.Table, file: Location) -> NDArray[np.float64]:
    """Convert columns qw, qx, qy, qz, tx_m, ty_m, tz_m to poses (rows, 4, 4). Raises InputError: one is no pose."""
    numbers = np.stack([column(table, name, np.float64, file) for name in _POSE], axis=1)
    return from_quaternion(numbers[:, :4], numbers[:, 4:], str(file))


UP, DOWN = "up_lidar", "down_lidar"
BEAMS_A_LIDAR = 32
"""Laser numbers below this belong to the upper LiDAR, the others to the lower LiDAR."""
_CATEGORIES = {
    "vehicle": """REGULAR_VEHICLE LARGE_VEHICLE BUS BOX_TRUCK TRUCK TRUCK_CAB SCHOOL_BUS ARTICULATED_BUS
        VEHICULAR_TRAILER RAILED_VEHICLE MESSAGE_BOARD_TRAILER TRAFFIC_LIGHT_TRAILER""",
    "pedestrian": "PEDESTRIAN OFFICIAL_SIGNALER",
    "cyclist": "BICYCLIST MOTORCYCLIST WHEELED_RIDER",
    "other": """ANIMAL BICYCLE BOLLARD CONSTRUCTION_BARREL CONSTRUCTION_CONE DOG MOBILE_PEDESTRIAN_CROSSING_SIGN
        MOTORCYCLE SIGN STOP_SIGN STROLLER WHEELCHAIR WHEELED_DEVICE""",
}
CLASSES = {name: kind for kind, names in _CATEGORIES.items() for name in names.split()}
_FARTHEST_NS = 20_000_000  # from a sweep's start and last firing to the nearest pose; poses are 5 to 10 ms apart
_SHORTEST_NS, _LONGEST_NS = 1_000_000, 200_000_000  # of a sweep's last firing: a hundredth of a turn, and two turns
_AT_ONCE = np.zeros(1, dtype=np.int64)
_TENTH_NS = 100_000_000  # interval of the velocity estimate


@dataclass(frozen=True)
class Sweep:
    """One turn of both LiDARs, in the order of the file.

    points: (N, 3) float32, metres, vehicle frame at the sweep's start. reflectance: (N,) float32, 0 to 1. is_up: (N,)
    bool, point of the upper LiDAR. offset_ns: (N,) int64 since the sweep's start.
    """

    points: NDArray[np.float32]
    reflectance: NDArray[np.float32]
    is_up: NDArray[np.bool_]
    offset_ns: NDArray[np.int64]


def sweep_file(log: Location, timestamp: int) -> Location:
    return log / "sensors" / "lidar" / f"{timestamp}.feather"


def timestamps(log: Location) -> list[int]:
    """List the start times of a log's sweeps, nanoseconds, ascending."""
    return sorted(int(stem) for stem in stems_in(log / "sensors" / "lidar", ".feather") if stem.isdecimal())


def read_sweep(log: Location, timestamp: int) -> Sweep:
    """Read a sweep. Raises InputError: the file is missing or damaged, or laser numbers do not fit two LiDARs."""
    file = sweep_file(log, timestamp)
    table = feather_table(file, ("x", "y", "z", "intensity", "laser_number", "offset_ns"))
    points = np.stack([column(table, name, np.float32, file) for name in ("x", "y", "z")], axis=1)
    laser = column(table, "laser_number", np.int64, file)
    if laser.min() < 0 or laser.max() >= 2 * BEAMS_A_LIDAR:
        what = f"laser numbers up to {laser.max()}, 0 to 63 expected"
        raise InputError(what, str(file), "Give the data set's own file")
    intensity: NDArray[np.float32] = column(table, "intensity", np.float32, file)
    if intensity.max() > 255.0 or not intensity.min() >= 0.0:
        raise InputError("an intensity that is not 0 to 255", str(file), "Give the data set's own file")
    offset_ns = column(table, "offset_ns", np.int64, file)
    if offset_ns.min() < 0 or not _SHORTEST_NS <= offset_ns.max() <= _LONGEST_NS:
        what = f"firing times from {offset_ns.min():,} to {offset_ns.max():,} ns, where a sweep takes 0.1 s"
        raise InputError(what, str(file), "Convert the file: offset_ns counts nanoseconds from the sweep's start")
    return Sweep(points, intensity / np.float32(255.0), laser < BEAMS_A_LIDAR, offset_ns)


def lidar_mounts(log: Location) -> tuple[Float, Float]:
    """Read positions (3,) of upper and lower LiDAR, vehicle frame, metres. Raises InputError: one is missing."""
    file = log / "calibration" / "egovehicle_SE3_sensor.feather"
    table = feather_table(file, ("sensor_name", *_POSE))
    names, mounts = table["sensor_name"].to_pylist(), poses(table, file)
    for name in (UP, DOWN):
        if names.count(name) != 1:
            raise InputError(f"{names.count(name)} rows of {name}, 1 expected", str(file), _AGAIN)
    return mounts[names.index(UP), :3, 3], mounts[names.index(DOWN), :3, 3]


def city_SE3_ego(log: Location, timestamp: int, offset_ns: NDArray[np.int64] = _AT_ONCE) -> Float:
    """Compute the vehicle's poses (N, 4, 4) in the city frame at each time after a sweep's start.

    Raises InputError: the poses are missing, damaged, out of order, or of another time.
    """
    times, city = _city_poses(log)
    for offset in (0, int(offset_ns.max())):
        if np.abs(times - (timestamp + offset)).min() > _FARTHEST_NS:
            what = f"no pose near the sweep {timestamp}, {offset / 1e6:g} ms after its start"
            raise InputError(what, str(_poses_file(log)), "Pair files of one log: copy both again")
    return interpolate_poses(times, city, timestamp + offset_ns)


def ego_velocity_m_s(log: Location, timestamp: int) -> tuple[float, float, float] | None:
    """Compute the vehicle's velocity over 0.1 s after a sweep's start, in its frame there; None without a later pose.

    Raises: as `city_SE3_ego`.
    """
    times, city = _city_poses(log)
    later = min(_TENTH_NS, int(times[-1]) - timestamp)
    if later <= _FARTHEST_NS:
        return None
    start, end = interpolate_poses(times, city, np.array([timestamp, timestamp + later]))
    x, y, z = (inverse(start) @ end)[:3, 3] * (1e9 / later)
    return (float(x), float(y), float(z))


def _poses_file(log: Location) -> Location:
    return log / "city_SE3_egovehicle.feather"


def _city_poses(log: Location) -> tuple[NDArray[np.int64], Float]:
    """Read times (K,), nanoseconds, ascending, and poses (K, 4, 4) of the vehicle in the city frame."""
    file = _poses_file(log)
    table = feather_table(file, ("timestamp_ns", *_POSE))
    times = column(table, "timestamp_ns", np.int64, file)
    order = np.argsort(times, kind="stable")
    return times[order], poses(table, file)[order]


def read_labels(log: Location, timestamp: int, points: NDArray[np.float32], offset: Float) -> Labels:
    """Read the boxes of a sweep, in file order; none if the sweep or the log (test split) has no annotations.

    Args:
        points: (N, 3) scene frame; counted in the boxes. offset: (3,) scene origin in the vehicle frame, metres.

    Raises InputError: the file is damaged, of another log, or has an unknown category.
    """
    file = log / "annotations.feather"
    if not file.is_file():
        return Labels()
    table = feather_table(file, ("timestamp_ns", "category", "length_m", "width_m", "height_m", *_POSE))
    times = column(table, "timestamp_ns", np.int64, file)
    table = table.filter(pa.array(times == timestamp))
    if not table.num_rows:
        if not np.isin(times, timestamps(log)).any():
            raise InputError("it annotates no sweep of the log", str(file), "Pair files of one log: copy both again")
        return Labels()
    placed = poses(table, file)
    sizes = np.stack([column(table, f"{edge}_m", np.float64, file) for edge in ("length", "width", "height")], axis=1)
    boxes = np.concatenate((placed[:, :3, 3] - offset, sizes, heading_of(placed)[:, None]), axis=1)
    where = f"{file}, sweep {timestamp}"
    names = tuple(str(name) for name in table["category"].to_pylist())
    for name in names:
        if name not in CLASSES:
            raise InputError(f"unknown category {name!r}", where, f"Write one of {', '.join(CLASSES)}")
    return Labels.of_file(boxes, tuple(CLASSES[name] for name in names), names, points, where)
