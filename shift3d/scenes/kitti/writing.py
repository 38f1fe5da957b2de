"""Writer of a scene as a KITTI object frame, readable by this project and by other tools."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.geometry.boxes import corners_3d
from shift3d.geometry.rigid import rigid
from shift3d.scenes.kitti.files import GROUND, IMAGE_SIZE, Calibration

_P2 = np.array([[721.5377, 0.0, 609.5593, 0.0], [0.0, 721.5377, 172.854, 0.0], [0.0, 0.0, 1.0, 0.0]])
_CAMERA_R_LIDAR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
CALIBRATION = Calibration(_P2, rigid(_CAMERA_R_LIDAR, np.zeros(3)))
"""Camera at the LiDAR's position with KITTI's focal length, because scenes have no camera."""
_NAMES = {"vehicle": "Car", "pedestrian": "Pedestrian", "cyclist": "Cyclist"}


def velodyne_bytes(points: NDArray[np.float32], reflectance: NDArray[np.float32] | None) -> bytes:
    """Encode points (N, 3) and reflectance (N,), 0 if None, as records of four little-endian float32."""
    rows = np.zeros((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    if reflectance is not None:
        rows[:, 3] = reflectance
    return rows.tobytes()


def frame_files(
    name: str,
    points: NDArray[np.float32],
    reflectance: NDArray[np.float32] | None,
    ground_z_m: float,
    boxes: NDArray[np.float64],
    classes: Sequence[str],
) -> dict[str, bytes]:
    """Return the files of one frame by their path under KITTI's root.

    Args:
        name: of the frame, such as "000000". points: (N, 3) LiDAR frame. reflectance: (N,) 0 to 1.
        boxes: (M, 7) LiDAR frame, all around; KITTI itself labels only the camera's view. classes: M of shift3d's.
    """
    matrices = {"P2": _P2, "R0_rect": np.eye(3), "Tr_velo_to_cam": CALIBRATION.camera_T_lidar[:3]}
    lines = (f"{key}: {' '.join(f'{value:.12e}' for value in matrices[key].ravel())}\n" for key in matrices)
    labels = "".join(f"{label_line(kind, box)}\n" for kind, box in zip(classes, boxes, strict=True))
    return {
        f"training/velodyne/{name}.bin": velodyne_bytes(points, reflectance),
        f"training/calib/{name}.txt": "".join(lines).encode(),
        f"training/label_2/{name}.txt": labels.encode(),
        f"training/{GROUND}/{name}.txt": f"{ground_z_m!r}\n".encode(),
    }


def label_line(kind: str, box: NDArray[np.float64]) -> str:
    """Format a box (7,) of a class as a line of a label file, the inverse of `files.lidar_box`.

    Occlusion is 3, unknown. The image box is clipped to the image, and empty if the camera does not see the object.
    """
    x, y, z, length, width, height, heading = (float(value) for value in box)
    bottom = CALIBRATION.camera_T_lidar[:3, :3] @ np.array([x, y, z - height / 2.0])
    turn = math.remainder(-heading - math.pi / 2.0, 2.0 * math.pi)
    alpha = math.remainder(turn - math.atan2(bottom[0], bottom[2]), 2.0 * math.pi)
    left, top, right, low = _in_image(box)
    numbers = (alpha, left, top, right, low, height, width, length, *bottom, turn)
    return " ".join([_NAMES.get(kind, "Misc"), "0.00", "3", *(f"{value:.9f}" for value in numbers)])


def _in_image(box: NDArray[np.float64]) -> tuple[float, float, float, float]:
    pixels, depth = CALIBRATION.pixels(corners_3d(box[None]).reshape(-1, 3))
    if (depth < 0.1).any():
        return (0.0, 0.0, 0.0, 0.0)
    held = np.clip(pixels, 0.0, IMAGE_SIZE)
    left, top, right, low = (float(value) for value in (*held.min(axis=0), *held.max(axis=0)))
    return (left, top, right, low) if right > left and low > top else (0.0, 0.0, 0.0, 0.0)
