"""Frames in OpenPCDet's layout of custom data as scenes."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.file_checks import (
    TWO_TURNS_RAD,
    abbreviated_list,
    names_in,
    read_array,
    read_lines,
    refuse_not_finite,
    require_metres,
)
from shift3d.scenes.ground_map import search_ground_z
from shift3d.scenes.reflectance import full_reflectance
from shift3d.scenes.scene import Labels, Scene
from shift3d.scenes.sets import RecordedScenes, shared_origins
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike

_CLASSES = {
    "vehicle": """vehicle motor_vehicle regular_vehicle large_vehicle big_vehicle other_vehicle emergency_vehicle
        construction_vehicle railed_vehicle type_vehicle car sedan suv van minivan pickup pickup_truck truck box_truck
        truck_cab bus school_bus articulated_bus trailer vehicular_trailer message_board_trailer traffic_light_trailer
        vehicle.car vehicle.truck vehicle.bus vehicle.bus.bendy vehicle.bus.rigid vehicle.trailer vehicle.construction
        vehicle.emergency.ambulance vehicle.emergency.police""",
    "pedestrian": """pedestrian person person_sitting official_signaler type_pedestrian human.pedestrian
        human.pedestrian.adult human.pedestrian.child human.pedestrian.construction_worker
        human.pedestrian.personal_mobility human.pedestrian.police_officer human.pedestrian.stroller
        human.pedestrian.wheelchair""",
    "cyclist": """cyclist bicyclist motorcyclist wheeled_rider bicycle motorcycle type_cyclist vehicle.bicycle
        vehicle.motorcycle""",
}
_CONVERT = "Write each frame as a float32 array (N, 4) with np.save (docs/guides/scenes.md)"
_COLUMNS = ("x", "y", "z", "dx", "dy", "dz", "heading", "class")


def class_of(name: str) -> str:
    """Map a name of a label file to a shift3d class; "other" if the name is unknown.

    Accepts the names of all supported data sets, in any case, with ``_``, ``-``, ``.`` or nothing between words.
    """
    return _CLASS_OF.get(_joined(name), "other")


def _joined(name: str) -> str:
    return re.sub(r"[-_.]", "", name).lower()


_CLASS_OF = {_joined(name): kind for kind, names in _CLASSES.items() for name in names.split()}


class OpenPcdetScenes(RecordedScenes):
    """Frames under a folder or bucket with points/NAME.npy, labels/NAME.txt and ImageSets/SPLIT.txt.

    Args:
        root: holds points/, and optionally labels/ and ImageSets/.
        names: frames to use; None: those of the split, or every file in points/, in order.
        count: maximum number of frames.
        split: the file in ImageSets/ that lists frames; None: every file in points/.
        sensor_m: position of the LiDAR in the frame of the points and labels, metres; axes are x forward, y left, z up.
        ground_z_m: height of the ground in that frame; None: estimated for each frame.
        reflectance_max: full reflectance in the fourth column; None: 1, or 255 if the column has such whole numbers.
        list_unreadable: also list frames of the split whose point file is missing; loading one raises InputError.

    A scene's origin is the LiDAR: points and boxes are moved there. A frame's points are rows of x, y, z and, from four
    columns on, reflectance. A label is ``x y z dx dy dz heading class``: box centre, heading counter-clockwise from +x.

    Raises InputError: no folder points/, no file of the split, a listed frame that does not exist, or a ground that is
    not below the LiDAR.
    """

    dataset = "openpcdet"

    def __init__(
        self,
        root: LocationLike,
        names: Sequence[str] | None = None,
        count: int | None = None,
        split: str | None = None,
        sensor_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        ground_z_m: float | None = None,
        reflectance_max: float | None = None,
        list_unreadable: bool = False,
    ) -> None:
        super().__init__(root, names, count, list_unreadable)
        self.sensor_m, self.ground_z_m, self.reflectance_max = tuple(sensor_m), ground_z_m, reflectance_max
        self._split = split
        if ground_z_m is not None and ground_z_m >= self.sensor_m[2]:
            what = f"the ground at {ground_z_m:g} m is not below the LiDAR at {self.sensor_m[2]:g} m"
            remedy = "Give the height in the frame of the points: negative if the LiDAR is at the origin"
            raise InputError(what, "scenes.ground_z_m", remedy)
        inside = names_in(self.root)
        if "points" not in inside:
            raise InputError("no folder points/", str(self.root), "Give the folder that holds points/ and labels/")
        self._has_labels, self._found_in = "labels" in inside, self.root / "points"
        self.names()

    def _found(self) -> list[str]:
        files = self._found_in.names()
        found = [name.removesuffix(".npy") for name in files if name.endswith(".npy")]
        if files and not found:
            raise InputError(f"no .npy file among {abbreviated_list(files)}", str(self._found_in), _CONVERT)
        if self._split is None:
            return found
        listed_in = self.root / "ImageSets" / f"{self._split}.txt"
        listed = _listed_in(listed_in)
        absent = sorted(set(listed) - set(found))
        if absent and not self.list_unreadable:
            remedy = "Add the frame, or leave it out of the list"
            raise InputError(f"no frame points/{absent[0]}.npy", str(listed_in), remedy)
        return listed

    def _read(self, name: str) -> Scene:
        self._require_listed(name)
        file = self.root / "points" / f"{name}.npy"
        values = _read_points(file)
        sensor = np.array(self.sensor_m, dtype=np.float64)
        points = (values[:, :3] - sensor).astype(np.float32)
        points[~values[:, :3].any(axis=1)] = 0.0  # beams without a return in an organised cloud
        require_metres(np.linalg.norm(points.astype(np.float64), axis=1), str(file))
        return Scene(
            scene_id=name,
            dataset=self.dataset,
            points=points,
            origins=shared_origins(points),
            ground_z_m=self._ground(points, file),
            labels=self._labels(name, points, sensor),
            reflectance=self._reflectance(values, file),
        )

    def _settings_and_files(self, name: str) -> tuple[Sequence[float | None], Sequence[Location]]:
        files = (self.root / "points" / f"{name}.npy", self.root / "labels" / f"{name}.txt")
        return (*self.sensor_m, self.ground_z_m, self.reflectance_max, self._has_labels), files

    def _ground(self, points: NDArray[np.float32], file: Location) -> float:
        if self.ground_z_m is not None:
            return self.ground_z_m - float(self.sensor_m[2])
        found = search_ground_z(points)
        if found is None:
            remedy = "Give scenes.ground_z_m, and scenes.sensor_m where the LiDAR is not at the origin"
            raise InputError("too few points on the ground around the sensor to tell its height", str(file), remedy)
        return found

    def _reflectance(self, values: NDArray[np.float64], file: Location) -> NDArray[np.float32] | None:
        if values.shape[1] < 4:
            return None
        full = full_reflectance(values[:, 3], str(file), self.reflectance_max, "Give scenes.reflectance_max")
        return np.clip(values[:, 3] / full, 0.0, 1.0).astype(np.float32)

    def _labels(self, name: str, points: NDArray[np.float32], sensor: NDArray[np.float64]) -> Labels:
        if not self._has_labels:
            return Labels()
        file = self.root / "labels" / f"{name}.txt"
        boxes, names = [], []
        remedy = "Add it, empty where nothing is labelled, or take the folder labels/ away"
        for number, line in enumerate(read_lines(file, "label file", remedy), start=1):
            words = line.split()
            if not words:
                continue
            box = _box(words, f"{file}, line {number}")
            boxes.append([*(box[:3] - sensor), *box[3:]])
            names.append(words[7])
        stacked = np.array(boxes, dtype=np.float64).reshape(-1, 7)
        classes = tuple(class_of(name) for name in names)
        return Labels.of_file(stacked, classes, tuple(names), points, str(file))


def _listed_in(file: Location) -> list[str]:
    words = [line.strip() for line in read_lines(file, "list of frames", "Add it, or give no scenes.split")]
    found = list(dict.fromkeys(word for word in words if word))
    if not found:
        raise InputError("it lists no frames", str(file), "Give another scenes.split, or null")
    return found


def _read_points(file: Location) -> NDArray[np.float64]:
    """Read the array (N, C) float64 of a .npy file, C >= 3."""
    values = read_array(file)
    if values.ndim != 2 or values.shape[1] < 3:
        what = f"{values.shape}, not rows of x, y, z and reflectance"
        raise InputError(what, str(file), "Give a float32 array (N, 4)")
    refuse_not_finite(values, str(file))
    return values.astype(np.float64)


def _box(words: Sequence[str], where: str) -> NDArray[np.float64]:
    if len(words) != len(_COLUMNS):
        raise InputError(f"{len(words)} columns, {len(_COLUMNS)} expected", where, f"Write {' '.join(_COLUMNS)}")
    try:
        box = np.array([float(word) for word in words[:7]])
    except ValueError as error:
        raise InputError(f"a column that is no number ({error})", where, f"Write {' '.join(_COLUMNS)}") from error
    if not np.isfinite(box).all() or not (box[3:6] > 0.0).all():
        raise InputError(f"a box of {box[3:6].tolist()} m", where, "Write positive sizes, and finite numbers alone")
    if abs(box[6]) > TWO_TURNS_RAD:
        raise InputError(f"a heading of {box[6]:g} rad, over two turns", where, "Write headings in radians")
    return box
