"""Readers of the three files of a KITTI object frame: velodyne, calib, label_2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import corners_3d
from shift3d.scenes.file_checks import (
    FARTHEST_M,
    TWO_TURNS_RAD,
    read_lines,
    read_records,
    refuse_not_finite,
    require_metres,
)
from shift3d.scenes.reflectance import full_reflectance
from shift3d.store.resolve import LocationLike, as_location
from shift3d.wording import counted

Float = NDArray[np.float64]

# Waymo's "vehicle" comprises KITTI's Car, Van and Truck; labels keep the KITTI name beside the class.
CLASSES = {
    "Car": "vehicle",
    "Van": "vehicle",
    "Truck": "vehicle",
    "Pedestrian": "pedestrian",
    "Person_sitting": "pedestrian",
    "Cyclist": "cyclist",
    "Tram": "other",
    "Misc": "other",
}
_CALIB_SHAPES = {"P2": (3, 4), "R0_rect": (3, 3), "Tr_velo_to_cam": (3, 4)}
_LABEL_COLUMNS = 15
GROUND = "ground"
"""Folder of an exported frame's ground height, one number a file. KITTI's own frames have none; it is estimated."""
IMAGE_SIZE = (1242, 375)  # pixels; frames differ by a few pixels, and images are not read
SMALLEST_M = 0.01  # labels are written to the centimetre
_ROTATION_TOLERANCE = 0.02  # of the rows' products: files have 7 digits
_COPY = "Copy the calibration file again."
_RESCALE = "Set scenes.reflectance_max to what the files call full reflectance (255, 65535, ...; null: 1)"
_LARGEST_PIXEL = 1e6  # of a projection's entries: focal lengths are some hundred pixels


@dataclass(frozen=True)
class Calibration:
    """Calibration of camera 2 of one frame. KITTI has labels only in its view.

    Attributes:
        image_P_camera: (3, 4) projection from the rectified camera frame (x right, y down, z forward) to pixels.
        camera_T_lidar: (4, 4) rigid transform from the LiDAR frame to the rectified camera frame.
    """

    image_P_camera: Float  # noqa: N815
    camera_T_lidar: Float  # noqa: N815

    def lidar_from_camera(self, points: NDArray[np.floating]) -> Float:
        """Transform points (N, 3) from the rectified camera frame to the LiDAR frame, metres."""
        inverse = np.linalg.inv(self.camera_T_lidar)
        lidar: Float = np.asarray(points, dtype=np.float64) @ inverse[:3, :3].T + inverse[:3, 3]
        return lidar

    def in_view(self, boxes: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return the mask (M,) of boxes (M, 7) whose centre lies between the image's left and right edges.

        Used for average precision: a detection outside may be right but has no label to match.
        """
        pixels, depth = self.pixels(np.asarray(boxes)[:, :3])
        return (pixels[:, 0] >= 0) & (pixels[:, 0] < IMAGE_SIZE[0]) & (depth > 0.0)

    def height_px(self, boxes: NDArray[np.floating]) -> Float:
        """Compute the image height of boxes (M, 7), clipped to the image: (M,) float64, pixels.

        A box that reaches behind the camera gets the whole height.
        """
        pixels, depth = self.pixels(corners_3d(boxes).reshape(-1, 3))
        rows = np.clip(pixels[:, 1], 0.0, IMAGE_SIZE[1]).reshape(-1, 8)
        height: Float = rows.max(axis=1, initial=0.0) - rows.min(axis=1, initial=IMAGE_SIZE[1])
        return np.where((depth.reshape(-1, 8) > 0.1).all(axis=1), height, float(IMAGE_SIZE[1]))

    def pixels(self, points: NDArray[np.floating]) -> tuple[Float, Float]:
        """Project points (N, 3) of the LiDAR frame: pixels (N, 2) as (column, row), and depth (N,) in metres."""
        camera = np.asarray(points, np.float64) @ self.camera_T_lidar[:3, :3].T + self.camera_T_lidar[:3, 3]
        image = camera @ self.image_P_camera[:, :3].T + self.image_P_camera[:, 3]
        depth = image[:, 2]
        return image[:, :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)[:, None], depth


@dataclass(frozen=True)
class KittiLabel:
    """One row of a label file: KITTI name and box (7,) in the LiDAR frame, in shift3d's convention.

    truncation: share of the object outside the image, 0 to 1. occlusion: 0 none, 1 partly, 2 largely, 3 unknown.
    image_height_px: height of the object's box in the image.
    """

    name: str
    box: Float
    truncation: float = 0.0
    occlusion: int = 0
    image_height_px: float = float("inf")

    @property
    def difficulty(self) -> int:
        """Easiest of KITTI's classes that admits the object: 0 easy, 1 moderate, 2 hard, 3 none of them.

        Source: KITTI's development kit: 40, 25, 25 pixels; occlusion up to 0, 1, 2; truncation up to 0.15, 0.3, 0.5.
        """
        limits = ((40.0, 0, 0.15), (25.0, 1, 0.30), (25.0, 2, 0.50))
        for grade, (height_px, occlusion, truncation) in enumerate(limits):
            if self.image_height_px >= height_px and self.occlusion <= occlusion and self.truncation <= truncation:
                return grade
        return len(limits)


def read_points(
    path: LocationLike, reflectance_max: float | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read points (N, 3) in the LiDAR frame and reflectance (N,) of a velodyne file, in file order.

    Args:
        reflectance_max: file value of full reflectance; None: 1. Reflectance is divided by it and clipped to 0..1.

    Raises InputError: the file is missing, empty, or not a whole number of 16-byte records; it contains NaN or
    infinity, ranges that are not metres (`require_metres`), or reflectances on another scale.
    """
    values = read_records(as_location(path), "frame", 4)
    refuse_not_finite(values, str(path))
    require_metres(np.linalg.norm(values[:, :3].astype(np.float64), axis=1), str(path))
    stated = 1.0 if reflectance_max is None else reflectance_max
    values[:, 3] /= full_reflectance(values[:, 3], str(path), stated, _RESCALE)
    return np.ascontiguousarray(values[:, :3]), np.clip(values[:, 3], 0.0, 1.0)


def read_calibration(path: LocationLike) -> Calibration:
    """Read the matrices of camera 2.

    Raises InputError: the file is missing; a line is missing, malformed or repeated; or the matrices are no rotation
    and no projection.
    """
    found: dict[str, Float] = {}
    for number, line in enumerate(read_lines(as_location(path), "calibration file"), start=1):
        key, _, rest = line.partition(":")
        if key not in _CALIB_SHAPES:
            continue
        shape = _CALIB_SHAPES[key]
        values = _numbers(rest.split(), f"{path}, line {number} ({key})")
        if len(values) != shape[0] * shape[1]:
            what = f"{counted(len(values), 'number')} for {key}, {shape[0] * shape[1]} expected"
            raise InputError(what, f"{path}, line {number}", _COPY)
        if key in found:
            raise InputError(f"{key} is there twice", f"{path}, line {number}", "Remove the one that is wrong.")
        found[key] = np.array(values).reshape(shape)
    missing = [key for key in _CALIB_SHAPES if key not in found]
    if missing:
        raise InputError(f"no line {missing[0]}:", str(path), _COPY)
    return _checked(found, path)


def _checked(found: dict[str, Float], path: LocationLike) -> Calibration:
    """Check that the matrices are a rotation and a projection. NaN fails every comparison in this form."""
    camera_T_lidar = np.eye(4)
    with np.errstate(over="ignore", invalid="ignore"):
        camera_T_lidar[:3] = found["R0_rect"] @ found["Tr_velo_to_cam"]
        rotation = camera_T_lidar[:3, :3]
        # The determinant alone would admit diag(2, 0.5, 1), which stretches every box.
        askew = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (askew <= _ROTATION_TOLERANCE and np.linalg.det(rotation) > 0.0):
        raise InputError("R0_rect · Tr_velo_to_cam is no rotation", str(path), _COPY)
    if not np.abs(camera_T_lidar[:3, 3]).max() <= FARTHEST_M:
        raise InputError("Tr_velo_to_cam moves by kilometres", str(path), _COPY)
    projection = found["P2"]
    camera = projection[0, 0] > 0.0 and projection[1, 1] > 0.0 and np.abs(projection).max() <= _LARGEST_PIXEL
    if not (camera and np.abs(projection[2, :3] - (0.0, 0.0, 1.0)).max() <= _ROTATION_TOLERANCE):
        raise InputError("P2 is no projection of a rectified camera", str(path), _COPY)
    return Calibration(projection, camera_T_lidar)


def read_labels(path: LocationLike, calibration: Calibration) -> list[KittiLabel]:
    """Read the labels in file order, without DontCare rows.

    Raises InputError: the file is missing or a row is malformed.
    """
    labels = []
    for number, line in enumerate(read_lines(as_location(path), "label file"), start=1):
        columns, where = line.split(), f"{path}, line {number}"
        if not columns or columns[0] == "DontCare":
            continue
        if len(columns) not in (_LABEL_COLUMNS, _LABEL_COLUMNS + 1):
            raise InputError(f"{counted(len(columns), 'column')}, 15 expected", where, "Repair or remove that line.")
        if columns[0] not in CLASSES:
            what = f"unknown class {columns[0][:40]!r}"
            raise InputError(what, where, f"Write one of {', '.join(CLASSES)} and DontCare.")
        values = _numbers(columns[1:], where)
        if not SMALLEST_M <= min(values[7:10]) <= max(values[7:10]) <= FARTHEST_M:
            raise InputError(f"box size {tuple(values[7:10])} (h, w, l)", where, "Write positive sizes, in metres.")
        if not max(abs(value) for value in values[10:13]) <= FARTHEST_M:
            raise InputError(f"box at {tuple(values[10:13])}", where, "Give its place in metres.")
        if abs(values[13]) > TWO_TURNS_RAD:
            raise InputError(f"rotation_y {values[13]:g}, over two turns", where, "Write it in radians.")
        box = lidar_box(values[7:10], values[10:13], values[13], calibration)
        labels.append(KittiLabel(columns[0], box, values[0], int(values[1]), values[6] - values[4]))
    return labels


def read_ground_z(path: LocationLike) -> float:
    """Read the height of the ground in the LiDAR frame, metres. Raises InputError: the file contains anything else."""
    words = " ".join(read_lines(as_location(path), "ground file")).split()
    values = _numbers(words, str(path))
    if len(values) != 1 or abs(values[0]) > FARTHEST_M:
        what = f"{counted(len(values), 'number')}, one height in metres expected"
        raise InputError(what, str(path), "Export the frame again.")
    return values[0]


def lidar_box(size_hwl: list[float], bottom_camera: list[float], rotation_y: float, calibration: Calibration) -> Float:
    """Convert a KITTI camera-frame box to (x, y, z, dx, dy, dz, heading) in the LiDAR frame.

    Args:
        size_hwl: height, width, length in metres.
        bottom_camera: centre of the box's BOTTOM in the rectified camera frame (y points down).
        rotation_y: about the camera's y axis; 0: the nose points along camera x (to the right).

    Returns: (7,) with the geometric centre, without the small roll and pitch between camera and LiDAR.
    """
    height, width, length = size_hwl
    nose = np.array([np.cos(rotation_y), 0.0, -np.sin(rotation_y)])
    centre = np.array(bottom_camera) - np.array([0.0, height / 2.0, 0.0])
    middle, ahead = calibration.lidar_from_camera(np.stack((centre, centre + nose)))
    heading = np.arctan2(ahead[1] - middle[1], ahead[0] - middle[0])
    return np.array([*middle, length, width, height, heading])


def _numbers(words: list[str], where: str) -> list[float]:
    values = []
    for word in words:
        try:
            value = float(word)
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise InputError(f"{word[:40]!r} is not a finite number", where, "Repair or remove that line.")
        values.append(value)
    return values
