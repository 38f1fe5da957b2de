"""Writer of a nuScenes release: tables, key frames and the sweeps between them, of a wall that a car drives past."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

VERSION = "v1.0-mini"
START_US, PERIOD_US = 1532402927647951, 50_000
MOUNT_M = (0.94, 0.0, 1.84)
MOUNT_YAW = -np.pi / 2 + 0.01  # the sensor's x points to the right
SPEED_M_S = 8.0
SWEEPS, KEY_EVERY = 7, 3  # of each drive; key frames are sweeps 0, 3, 6
BOX = (14.0, -4.0, 0.8, 4.5, 1.9, 1.6, 0.3)  # a car beside the road, vehicle frame at the first key frame
RINGS, COLUMNS = 32, 60


def pose(yaw: float, xyz: tuple[float, float, float]) -> np.ndarray:
    out = np.eye(4)
    out[:2, :2], out[:3, 3] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]], xyz
    return out


def row_of(yaw: float, xyz: tuple[float, ...]) -> dict[str, Any]:
    return {"rotation": [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))], "translation": [*map(float, xyz)]}


def drive_at(time_s: float, drive: int) -> tuple[float, tuple[float, float, float]]:
    """Return yaw and place of the vehicle in the global frame: poses of this data set are level and at height 0."""
    yaw = 0.6 + drive
    return yaw, (411.0 + SPEED_M_S * time_s * np.cos(yaw), 1180.0 + SPEED_M_S * time_s * np.sin(yaw), 0.0)


def global_SE3_lidar(time_s: float, drive: int) -> np.ndarray:
    return pose(*drive_at(time_s, drive)) @ pose(MOUNT_YAW, MOUNT_M)


def write_release(root: Path, drives: int = 1, description: str = "Rain, parked cars") -> None:
    """Write the tables and LiDAR files below root."""
    tables: dict[str, list[dict[str, Any]]] = {
        name: [] for name in ("scene", "sample", "sample_data", "ego_pose", "sample_annotation")
    }
    tables["calibrated_sensor"] = [
        {"token": "mount", "sensor_token": "lidar", **row_of(MOUNT_YAW, MOUNT_M)},
        {"token": "camera", "sensor_token": "camera", **row_of(0.0, (1.7, 0.0, 1.5))},
    ]
    tables["category"] = [{"token": "c1", "name": "vehicle.car"}, {"token": "c2", "name": "vehicle.bicycle"}]
    tables["instance"] = [{"token": "i1", "category_token": "c1"}, {"token": "i2", "category_token": "c2"}]
    for drive in range(drives):
        _write_drive(root, tables, drive, description)
    (root / VERSION).mkdir(parents=True)
    for name, rows in tables.items():
        order = np.random.default_rng(len(name)).permutation(len(rows))
        (root / VERSION / f"{name}.json").write_text(json.dumps([rows[i] for i in order], indent=0))


def _write_drive(root: Path, tables: dict[str, list[dict[str, Any]]], drive: int, description: str) -> None:
    tables["scene"].append({"token": f"drive{drive}", "description": description})
    for number in range(SWEEPS):
        time_us = START_US + drive * 10**9 + number * PERIOD_US
        is_key = number % KEY_EVERY == 0
        sample = f"sample{drive}{-(-number // KEY_EVERY)}"
        folder = "samples" if is_key else "sweeps"
        name = f"{folder}/LIDAR_TOP/drive{drive}-{time_us}.pcd.bin"
        time_s = number * PERIOD_US * 1e-6
        yaw, place = drive_at(time_s, drive)
        pose_row = {"token": f"pose{drive}{number}", "timestamp": time_us, **row_of(yaw, place)}
        data = {
            "token": f"data{drive}{number}",
            "sample_token": sample,
            "ego_pose_token": pose_row["token"],
            "calibrated_sensor_token": "mount",
            "timestamp": time_us,
            "is_key_frame": is_key,
            "filename": name,
            "prev": f"data{drive}{number - 1}" if number else "",
        }
        camera = {"token": f"image{drive}{number}", "filename": f"{folder}/CAM_FRONT/{time_us}.jpg", "prev": ""}
        tables["ego_pose"].append(pose_row)
        tables["sample_data"] += [data, {**data, **camera}]
        if is_key:
            tables["sample"].append({"token": sample, "scene_token": f"drive{drive}", "timestamp": time_us})
            tables["sample_annotation"] += _annotations(sample, drive)
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        scan(global_SE3_lidar(time_s, drive), drive).astype("<f4").tofile(path)


def _annotations(sample: str, drive: int) -> list[dict[str, Any]]:
    x, y, z, length, width, height, yaw = BOX
    vehicle_yaw, place = drive_at(0.0, drive)
    at = pose(vehicle_yaw, place) @ [x, y, z, 1.0]
    size = [width, length, height]
    car = {"token": f"a{sample}", "sample_token": sample, "instance_token": "i1", "size": size}
    bicycle = {"token": f"b{sample}", "sample_token": sample, "instance_token": "i2", "size": [0.6, 1.8, 1.2]}
    placed = row_of(yaw + vehicle_yaw, at[:3])
    return [{**car, **placed, "num_lidar_pts": 0}, {**bicycle, **placed, "num_lidar_pts": 0}]


def scan(global_SE3_lidar: np.ndarray, drive: int) -> np.ndarray:
    """Return (N, 5): ground and walls 12 m to each side, by rings from the lowest, column by column; the roof last."""
    turn = np.repeat(np.pi - 2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS, RINGS)
    ring = np.tile(np.arange(RINGS), COLUMNS)
    up = np.deg2rad(-30.6 + 41.3 * ring / (RINGS - 1))
    own = np.stack((np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)), axis=1)
    road = np.linalg.inv(pose(*drive_at(0.0, drive))) @ global_SE3_lidar
    origin, away = road[:3, 3], own @ road[:3, :3].T
    with np.errstate(divide="ignore"):
        walls = np.where(away[:, 1] > 0, (12.0 - origin[1]) / away[:, 1], (-12.0 - origin[1]) / away[:, 1])
        ground = np.where(away[:, 2] < 0, -origin[2] / away[:, 2], np.inf)
    reach = np.minimum(walls, ground)
    seen = reach < 90.0
    points = np.column_stack((own * reach[:, None], np.full(len(own), 51.0), ring))[seen]
    roof = np.array([[0.2, 0.3, -0.4, 3.0, 0.0], [-0.5, 0.9, -0.3, 3.0, 1.0]])
    return np.concatenate((points, roof))


def change_table(root: Path, name: str, change: Callable[[list[dict[str, Any]]], Any]) -> None:
    """Rewrite a table after a change, which may return other rows."""
    path = root / VERSION / f"{name}.json"
    rows = json.loads(path.read_text())
    changed = change(rows)
    path.write_text(json.dumps(rows if changed is None else changed))
