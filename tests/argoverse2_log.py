"""Writer of an Argoverse 2 log: two LiDARs that turn clockwise on a vehicle that drives and turns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather

LOG = "0a0b0c0d-1111-2222-3333-444455556666"
START, PERIOD = 315966265259836000, 100_192_000  # nanoseconds
UP, DOWN = (1.35, 0.0, 1.64), (1.34, 0.01, 1.52)
SPEED_M_S, TURN_RAD_S = 9.0, 0.3
BOX = (12.0, -3.0, 0.6, 4.4, 1.9, 1.6, 0.5)  # a car, vehicle frame
COLUMNS = 90


def city_SE3_ego(time_ns: int) -> np.ndarray:
    """Return the vehicle's pose (4, 4), level like the poses of the log."""
    time_s = (time_ns - START) * 1e-9
    yaw, out = -0.4 + TURN_RAD_S * time_s, np.eye(4)
    out[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    out[:3, 3] = (5172.0 + SPEED_M_S * time_s * np.cos(-0.4), 2419.0 + SPEED_M_S * time_s * np.sin(-0.4), 66.9)
    return out


def quaternion(yaw: float) -> dict[str, float]:
    return {"qw": float(np.cos(yaw / 2)), "qx": 0.0, "qy": 0.0, "qz": float(np.sin(yaw / 2))}


def write_log(root: Path, sweeps: int = 2, labels: bool = True, counts: bool = True, width: type = np.float16) -> Path:
    """Write a log below root and return its folder. counts: if annotations have num_interior_pts."""
    log = root / LOG
    for part in ("sensors/lidar", "calibration"):
        (log / part).mkdir(parents=True)
    rows = [{"sensor_name": "ring_front_center", **quaternion(0.0), "tx_m": 1.6, "ty_m": 0.0, "tz_m": 1.4}]
    for name, (x, y, z) in (("up_lidar", UP), ("down_lidar", DOWN)):
        rows.append({"sensor_name": name, **quaternion(0.0), "tx_m": x, "ty_m": y, "tz_m": z})
    _write(log / "calibration" / "egovehicle_SE3_sensor.feather", rows)
    poses = []
    for time_ns in range(START - 50_000_000, START + sweeps * PERIOD + 200_000_000, 10_000_000):
        pose = city_SE3_ego(time_ns)
        x, y, z = pose[:3, 3]
        yaw = np.arctan2(pose[1, 0], pose[0, 0])
        poses.append({"timestamp_ns": time_ns, **quaternion(yaw), "tx_m": x, "ty_m": y, "tz_m": z})
    _write(log / "city_SE3_egovehicle.feather", poses)
    annotations = []
    for sweep in range(sweeps):
        timestamp = START + sweep * PERIOD
        _write_sweep(log / "sensors" / "lidar" / f"{timestamp}.feather", timestamp, width)
        for box, name in ((BOX, "REGULAR_VEHICLE"), ((8.0, 6.0, 0.9, 0.7, 0.7, 1.8, 0.0), "PEDESTRIAN")):
            x, y, z, length, breadth, height, yaw = box
            size = {"length_m": length, "width_m": breadth, "height_m": height}
            row = {"timestamp_ns": timestamp, "track_uuid": name, "category": name, **size, **quaternion(yaw)}
            annotations.append({**row, "tx_m": x, "ty_m": y, "tz_m": z} | ({"num_interior_pts": 1} if counts else {}))
    if labels:
        _write(log / "annotations.feather", annotations)
    return log


def _write_sweep(path: Path, timestamp: int, width: type) -> None:
    rng = np.random.default_rng(timestamp % 1000)
    column, laser = np.repeat(np.arange(COLUMNS), 64), np.tile(np.arange(64), COLUMNS)
    azimuth = np.repeat(2.0 - 2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS, 64)
    up = np.deg2rad(np.where(laser < 32, 15.0 - 40.0 * laser / 31, -25.0 + 40.0 * (laser - 32) / 31))
    reach = rng.uniform(3.0, 90.0, len(laser))
    offset = np.repeat((np.arange(COLUMNS) + 0.5) / COLUMNS * PERIOD, 64).astype(np.int32)
    away = np.stack((np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)), axis=1)
    start = np.linalg.inv(city_SE3_ego(timestamp))
    origins = np.empty((COLUMNS, 2, 3))
    for number, fired in enumerate(offset[::64]):
        now = start @ city_SE3_ego(timestamp + int(fired))
        for head, mount in enumerate((UP, DOWN)):
            origins[number, head] = now[:3, :3] @ np.array(mount) + now[:3, 3]
    points = origins[column, (laser >= 32).astype(int)] + reach[:, None] * away
    table = pa.table(
        {
            **{name: points[:, i].astype(width) for i, name in enumerate("xyz")},
            "intensity": rng.integers(0, 256, len(laser)).astype(np.uint8),
            "laser_number": laser.astype(np.uint8),
            "offset_ns": offset,
        }
    )
    feather.write_feather(table, path, compression="lz4")


def _write(path: Path, rows: list[dict]) -> None:
    feather.write_feather(pa.Table.from_pylist(rows), path)
