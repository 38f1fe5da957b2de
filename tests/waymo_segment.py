"""Writer of a Waymo Open Dataset segment, version 2, in its schema: five lasers, per-pixel poses, two returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

SEGMENT = "10023947602400723454_1120_000_1140_000"
START, PERIOD = 1552440195362591, 100_000  # microseconds
NAMES = {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"}
SHAPES = {1: (16, 180), 2: (12, 40), 3: (12, 40), 4: (12, 40), 5: (12, 40)}
MOUNTS = {  # x, y, z of each laser on the vehicle, metres, and its yaw
    1: (1.43, 0.0, 2.184, -2.6),
    2: (4.07, 0.0, 0.69, 0.01),
    3: (3.25, 1.02, 0.98, 1.58),
    4: (3.25, -1.02, 0.98, -1.56),
    5: (-1.15, 0.0, 0.46, 3.12),
}
SPEED_M_S, TURN_RAD_S = 12.0, 0.2
BOX = (18.0, 3.0, 1.0, 4.6, 2.0, 1.7, 0.4)  # a vehicle, vehicle frame
WIDE = pa.float64()
WITH_TABLE = (1, 3)  # lasers with a list of beam inclinations; the others have limits alone


def matrix(yaw: float, xyz: tuple[float, float, float], pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Return (4, 4) Rz Ry Rx with a translation, one elementary rotation after the other."""
    c, s = np.cos, np.sin
    rz = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    ry = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    rx = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rz @ ry @ rx, xyz
    return out


def pose_at(time_s: float) -> tuple[float, float, float, float, float, float]:
    """Return roll, pitch, yaw, x, y, z of the vehicle in the global frame."""
    yaw = 0.7 + TURN_RAD_S * time_s
    return 0.01, -0.02, yaw, 820.0 + SPEED_M_S * time_s * np.cos(0.7), -310.0 + SPEED_M_S * time_s * np.sin(0.7), 21.0


def global_SE3_vehicle(time_s: float) -> np.ndarray:
    roll, pitch, yaw, *xyz = pose_at(time_s)
    return matrix(yaw, (xyz[0], xyz[1], xyz[2]), pitch, roll)


@dataclass
class Segment:
    """The written data: images[frame, laser, return] (H, W, 4) float32, poses[frame] (H, W, 6) of the TOP laser."""

    images: dict[tuple[int, int, int], np.ndarray] = field(default_factory=dict)
    poses: dict[int, np.ndarray] = field(default_factory=dict)
    extrinsics: dict[int, np.ndarray] = field(default_factory=dict)
    inclinations: dict[int, np.ndarray] = field(default_factory=dict)


def write_segment(
    root: Path,
    frames: int = 3,
    transforms: pa.DataType = WIDE,
    laser_names: bool = False,
    segment: str = SEGMENT,
    zero_rows: int = 2,
) -> Segment:
    """Write every component; each has its rows in an order of its own, and small row groups.

    transforms: width of the numbers in transforms. laser_names: names in place of numbers, as in some published
    samples. zero_rows: at the bottom of the pose image.
    """
    made, rng = Segment(), np.random.default_rng(5)
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in _SCHEMAS}
    for laser, (x, y, z, yaw) in MOUNTS.items():
        made.extrinsics[laser] = matrix(yaw, (x, y, z), 0.003, -0.002)
        low, high = (-0.31, 0.04) if laser == 1 else (-1.5, 0.5)
        height = SHAPES[laser][0]
        even = low + (np.arange(height) + 0.5) / height * (high - low)
        table = np.sort(even + rng.uniform(-0.002, 0.002, height)) if laser in WITH_TABLE else even
        made.inclinations[laser] = table[::-1]
        rows["lidar_calibration"].append(
            {
                **_key(segment, laser=NAMES[laser] if laser_names else laser),
                "[LiDARCalibrationComponent].extrinsic.transform": made.extrinsics[laser].ravel().tolist(),
                "[LiDARCalibrationComponent].beam_inclination.min": low,
                "[LiDARCalibrationComponent].beam_inclination.max": high,
                "[LiDARCalibrationComponent].beam_inclination.values": table.tolist() if laser in WITH_TABLE else None,
            }
        )
    for frame in range(frames):
        _write_frame(made, rows, frame, segment, laser_names, zero_rows, rng)
    for order, (component, found) in enumerate(rows.items()):
        shuffled = [found[i] for i in np.random.default_rng(order).permutation(len(found))]
        schema = _schema(component, transforms, laser_names)
        (root / component).mkdir(parents=True, exist_ok=True)
        table = pa.Table.from_pylist(shuffled, schema=schema)
        pq.write_table(table, root / component / f"{segment}.parquet", row_group_size=4, compression="none")
    return made


def _write_frame(
    made: Segment,
    rows: dict[str, list[dict[str, Any]]],
    frame: int,
    segment: str,
    laser_names: bool,
    zero_rows: int,
    rng: np.random.Generator,
) -> None:
    time_s, timestamp = frame * PERIOD * 1e-6, START + frame * PERIOD
    for laser, (height, width) in SHAPES.items():
        name: int | str = NAMES[laser] if laser_names else laser
        first = np.zeros((height, width, 4), np.float32)
        first[..., 0] = rng.uniform(2.0, 70.0, (height, width))
        first[..., 1], first[..., 2] = rng.gamma(1.0, 0.4, (height, width)), rng.uniform(0, 1, (height, width))
        first[..., 3] = np.where(rng.random((height, width)) < 0.1, 1.0, -1.0)
        second = first.copy()
        second[..., 0] += rng.uniform(0.5, 5.0, (height, width)).astype(np.float32)
        second[rng.random((height, width)) < 0.9] = (-1.0, -1.0, -1.0, -1.0)
        gone = rng.random((height, width)) < 0.2
        first[gone], second[gone] = -1.0, -1.0
        made.images[frame, laser, 1], made.images[frame, laser, 2] = first, second
        images = {}
        for number, image in ((1, first), (2, second)):
            images[f"[LiDARComponent].range_image_return{number}.values"] = image.ravel().tolist()
            images[f"[LiDARComponent].range_image_return{number}.shape"] = list(image.shape)
        rows["lidar"].append({**_key(segment, timestamp, name), **images})
    height, width = SHAPES[1]
    poses = np.zeros((height, width, 6), np.float32)
    for column in range(width):  # the vehicle at the column's firing time, half a turn around the frame's time
        poses[:, column] = pose_at(time_s + (column / width - 0.5) * 0.1)
    made.poses[frame] = poses.copy()
    if zero_rows:
        poses[-zero_rows:] = 0.0
    values = {"values": poses.ravel().tolist(), "shape": list(poses.shape)}
    rows["lidar_pose"].append(
        {
            **_key(segment, timestamp, NAMES[1] if laser_names else 1),
            **{f"[LiDARPoseComponent].range_image_return1.{part}": value for part, value in values.items()},
        }
    )
    rows["vehicle_pose"].append(
        {
            **_key(segment, timestamp),
            "[VehiclePoseComponent].world_from_vehicle.transform": global_SE3_vehicle(time_s).ravel().tolist(),
        }
    )
    rows["stats"].append({**_key(segment, timestamp), "[StatsComponent].weather": "rain"})
    for index, (box, kind) in enumerate(((BOX, 1), ((9.0, -7.0, 0.9, 0.7, 0.7, 1.8, 0.0), 2))):
        names = ("center.x", "center.y", "center.z", "size.x", "size.y", "size.z", "heading")
        rows["lidar_box"].append(
            {
                **_key(segment, timestamp),
                "key.laser_object_id": f"object-{index}",
                **{f"[LiDARBoxComponent].box.{part}": value for part, value in zip(names, box, strict=True)},
                "[LiDARBoxComponent].type": kind,
                "[LiDARBoxComponent].num_lidar_points_in_box": None if index else 0,
                "[LiDARBoxComponent].difficulty_level.detection": None,
            }
        )


def _key(segment: str, timestamp: int | None = None, laser: int | str | None = None) -> dict[str, Any]:
    key: dict[str, Any] = {"key.segment_context_name": segment}
    if timestamp is not None:
        key["key.frame_timestamp_micros"] = timestamp
    if laser is not None:
        key["key.laser_name"] = laser
    return key


_IMAGE = {"values": pa.list_(pa.float32()), "shape": pa.list_(pa.int32(), 3)}
_SCHEMAS: dict[str, dict[str, Any]] = {
    "lidar": {
        f"[LiDARComponent].range_image_return{number}.{part}": kind
        for number in (1, 2)
        for part, kind in _IMAGE.items()
    },
    "lidar_pose": {f"[LiDARPoseComponent].range_image_return1.{part}": kind for part, kind in _IMAGE.items()},
    "lidar_calibration": {
        "[LiDARCalibrationComponent].extrinsic.transform": 16,
        "[LiDARCalibrationComponent].beam_inclination.min": pa.float64(),
        "[LiDARCalibrationComponent].beam_inclination.max": pa.float64(),
        "[LiDARCalibrationComponent].beam_inclination.values": pa.list_(pa.float64()),
    },
    "vehicle_pose": {"[VehiclePoseComponent].world_from_vehicle.transform": 16},
    "stats": {"[StatsComponent].weather": pa.string()},
    "lidar_box": {
        "key.laser_object_id": pa.string(),
        **{
            f"[LiDARBoxComponent].box.{part}": pa.float64()
            for part in ("center.x", "center.y", "center.z", "size.x", "size.y", "size.z", "heading")
        },
        "[LiDARBoxComponent].type": pa.int8(),
        "[LiDARBoxComponent].num_lidar_points_in_box": pa.int64(),
        "[LiDARBoxComponent].difficulty_level.detection": pa.int8(),
    },
}


def _schema(component: str, transforms: pa.DataType, laser_names: bool) -> pa.Schema:
    keys = [("key.segment_context_name", pa.string())]
    if component != "lidar_calibration":
        keys.append(("key.frame_timestamp_micros", pa.int64()))
    if component in ("lidar", "lidar_pose", "lidar_calibration"):
        keys.append(("key.laser_name", pa.string() if laser_names else pa.int8()))
    fields = [(name, pa.list_(transforms, 16) if kind == 16 else kind) for name, kind in _SCHEMAS[component].items()]
    return pa.schema([*keys, *fields])


def points_of(made: Segment, frame: int, laser: int, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, origins (vehicle frame, float64) and pixels of an image, pixel by pixel, by the transforms."""
    image, extrinsic = made.images[frame, laser, number], made.extrinsics[laser]
    height, width = image.shape[:2]
    vehicle_SE3_global = np.linalg.inv(global_SE3_vehicle(frame * PERIOD * 1e-6))
    correction = np.arctan2(extrinsic[1, 0], extrinsic[0, 0])
    points, origins, pixels = [], [], []
    for row in range(height):
        for column in range(width):
            reach = float(image[row, column, 0])
            if reach <= 0:
                continue
            azimuth = (2 * (width - column - 0.5) / width - 1) * np.pi - correction
            up = made.inclinations[laser][row]
            own = reach * np.array([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])
            chain = np.eye(4)
            if laser == 1:
                roll, pitch, yaw, *xyz = (float(value) for value in made.poses[frame][row, column])
                chain = vehicle_SE3_global @ matrix(yaw, (xyz[0], xyz[1], xyz[2]), pitch, roll)
            points.append((chain @ extrinsic @ [*own, 1.0])[:3])
            origins.append((chain @ extrinsic @ [0.0, 0.0, 0.0, 1.0])[:3])
            pixels.append((row, column))
    return np.array(points), np.array(origins), np.array(pixels)
