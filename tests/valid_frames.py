"""A small handmade KITTI frame, for the tests of its readers and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

NAME = "000007"

LABELS = """Car 0.00 0 -1.59 592.08 176.50 637.55 219.52 1.56 1.65 3.69 0.12 1.72 28.28 -1.58
Van 0.12 1 -1.27 895.35 158.55 1241.00 374.00 1.96 1.81 4.96 4.38 1.54 16.69 -0.71
Pedestrian 0.00 2 1.13 817.68 176.90 838.04 202.31 1.79 0.63 0.86 -4.61 1.57 20.40 2.72 0.93
DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10
"""
# In KITTI's form: the rectified camera looks along x, 0.27 m before and 0.08 m below the LiDAR, and is turned a little.
TURN = 0.0075
CALIBRATION = {
    "P0": np.array([[721.5377, 0.0, 609.5593, 0.0], [0.0, 721.5377, 172.854, 0.0], [0.0, 0.0, 1.0, 0.0]]),
    "P2": np.array([[721.5377, 0.0, 609.5593, 44.85728], [0.0, 721.5377, 172.854, 0.2163791], [0.0, 0.0, 1.0, 0.0027]]),
    "R0_rect": np.array([[np.cos(TURN), np.sin(TURN), 0.0], [-np.sin(TURN), np.cos(TURN), 0.0], [0.0, 0.0, 1.0]]),
    "Tr_velo_to_cam": np.array([[0.0, -1.0, 0.0, -0.004], [0.0, 0.0, -1.0, -0.076], [1.0, 0.0, 0.0, -0.272]]),
    "Tr_imu_to_velo": np.array([[1.0, 0.0, 0.0, -0.81], [0.0, 1.0, 0.0, 0.32], [0.0, 0.0, 1.0, -0.8]]),
}


def street(rows: int = 900) -> np.ndarray[Any, Any]:
    """Return (rows, 4) float32: flat ground 1.7 m below, a wall, a return without a range and two at one place."""
    rng = np.random.default_rng(3)
    azimuth = rng.uniform(-np.pi, np.pi, rows)
    distance = rng.uniform(4.0, 40.0, rows)
    points = np.stack((distance * np.cos(azimuth), distance * np.sin(azimuth), rng.normal(-1.7, 0.02, rows)), axis=1)
    points[-50:, 0], points[-50:, 2] = 30.0, rng.uniform(-1.5, 2.0, 50)
    points[0], points[2] = 0.0, points[1]
    return np.concatenate((points, rng.uniform(0.0, 1.0, (rows, 1))), axis=1).astype("<f4")


def calibration_text() -> str:
    return "".join(f"{key}: {' '.join(f'{v:.12e}' for v in m.ravel())}\n" for key, m in CALIBRATION.items())


def write_frame(folder: Path) -> None:
    for part in ("velodyne", "calib", "label_2"):
        (folder / "training" / part).mkdir(parents=True)
    street().tofile(folder / "training" / "velodyne" / f"{NAME}.bin")
    (folder / "training" / "calib" / f"{NAME}.txt").write_text(calibration_text())
    (folder / "training" / "label_2" / f"{NAME}.txt").write_text(LABELS)
