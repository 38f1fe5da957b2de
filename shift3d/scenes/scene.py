"""Record of one LiDAR sweep that all other code reads: points, labels, conditions of the recording."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import count_in_boxes, validate_boxes
from shift3d.scenes.file_checks import FARTHEST_M, TWO_TURNS_RAD, UNITS_REMEDY, refuse_not_finite, require_array
from shift3d.scenes.ground_map import GroundMap
from shift3d.scenes.sensor import NoReturnBeams, SensorModel

WEATHER_FIELDS = {"fog": "visibility_m", "rain": "rain_mm_h", "snow": "snow_mm_h"}
"""Field of `Conditions` with the strength of each weather, also the name of its setting. Of several weathers that
settings add to a scene, the last in this order names the scene's weather."""
WEATHERS = ("dry", *WEATHER_FIELDS)
LEAST_VISIBILITY_M = 1e-3
"""Densest fog (our choice). At 1e-15 m float64 has no two positions in the first metre to resolve the echo."""

FASTEST_M_S = 1e3
"""Largest speed of a sensor or an inserted object (our choice); larger: a damaged pose, a typing error."""


@dataclass(frozen=True)
class Labels:
    """Labelled objects of one scene.

    Attributes:
        boxes: (M, 7) float64, scene frame: x, y, z of the centre, dx, dy, dz (metres), heading from +x (radians).
        classes: M class names of shift3d: "vehicle", "pedestrian", "cyclist", "other".
        num_points: (M,) int32, points of the scene inside each box.
        names: M class names of the data set ("Car", "Van", ...); empty if it has none.
        kinds: M body types with attributes ("sedan", "suv+roof_box"; "" for non-vehicles); empty if unknown.
    """

    boxes: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 7)))
    classes: tuple[str, ...] = ()
    num_points: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    names: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()

    @staticmethod
    def of_file(
        boxes: NDArray[np.float64],
        classes: tuple[str, ...],
        names: tuple[str, ...],
        points: NDArray[np.float32],
        where: str,
    ) -> Labels:
        """Make the labels of a file, and count the points (N, 3) in each box. where: the file, for the error.

        Raises InputError: a box that is not finite, has no volume, or cannot be in metres and radians.
        """
        _validate_label_boxes(boxes, where)
        return Labels(boxes, classes, count_in_boxes(points, boxes), names)

    def of_class(self, name: str) -> NDArray[np.float64]:
        """Return the boxes (K, 7) of one class, in label order."""
        return self.boxes[self.mask(name)]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return the mask (M,) of the labels of one class."""
        return np.array([label == name for label in self.classes], dtype=np.bool_)

    def validate(self, where: str) -> None:
        """Refuse labels that do not fit together. where: the scene, for the error.

        Raises InputError: naming the field, the row and the remedy.
        """
        _validate_label_boxes(self.boxes, f"{where}, labels.boxes")
        count = len(self.boxes)
        for name, one in (("classes", "class"), ("names", "name"), ("kinds", "kind")):
            values = getattr(self, name)
            if len(values) != count and (values or name == "classes"):
                remedy = f"Give one {one} a box" + ("." if name == "classes" else ", or none at all.")
                raise InputError(f"{len(values)} {name} for {count} boxes", f"{where}, labels.{name}", remedy)
        if self.num_points.shape != (count,):
            what = f"shape {self.num_points.shape} for {count} boxes"
            raise InputError(what, f"{where}, labels.num_points", "Give one count a box.")
        if (self.num_points < 0).any():
            row = int(np.argmax(self.num_points < 0))
            what = f"row {row} is {self.num_points[row]}"
            raise InputError(what, f"{where}, labels.num_points", "Give counts of at least 0.")


def _validate_label_boxes(boxes: NDArray[np.float64], where: str) -> None:
    validate_boxes(boxes, where)
    if (far := np.abs(boxes[:, :6]).max(axis=1, initial=0.0) > FARTHEST_M).any():
        what = f"box {int(far.argmax())} has place and size {boxes[far.argmax(), :6].tolist()}"
        raise InputError(what, where, "Repair the box, or the pose of its frame: metres, at most 10 km")
    if (turned := np.abs(boxes[:, 6]) > TWO_TURNS_RAD).any():
        what = f"box {int(turned.argmax())} has a heading of {boxes[turned.argmax(), 6]:g} rad, over two turns"
        raise InputError(what, where, UNITS_REMEDY)


@dataclass(frozen=True)
class Conditions:
    """Conditions of the recording that effects ask for.

    Attributes:
        weather: one of :data:`WEATHERS`.
        rain_mm_h: rain rate; 0 without rain.
        snow_mm_h: rate of snowfall as melted water; 0 without snow.
        visibility_m: meteorological optical range; infinite in clear air.
        ego_velocity_m_s: (vx, vy, vz) of the sensor in the scene frame; None if unknown.
        weather_in_points: the points contain the weather, as in a recording. Effects then change the object alone.
        motion_compensated: points are given at time 0 in the frame of the sensor at time 0 (origins then follow the
            sensor). Otherwise each point is in the frame of the sensor at its firing time.
    """

    weather: str = "dry"
    rain_mm_h: float = 0.0
    snow_mm_h: float = 0.0
    visibility_m: float = float("inf")
    ego_velocity_m_s: tuple[float, float, float] | None = None
    weather_in_points: bool = True
    motion_compensated: bool = True

    def validate(self, where: str) -> None:
        """Refuse conditions out of range. Raises InputError: naming the field and the remedy."""
        if self.weather not in WEATHERS:
            what = f"unknown weather {self.weather!r}"
            raise InputError(what, f"{where}, conditions.weather", f"Choose from {', '.join(WEATHERS)}.")
        if not self.visibility_m >= LEAST_VISIBILITY_M:
            remedy = f"Give at least {LEAST_VISIBILITY_M:g} m (inf: clear)."
            raise InputError(f"{self.visibility_m} m", f"{where}, conditions.visibility_m", remedy)
        for name in WEATHER_FIELDS.values():
            value = getattr(self, name)
            if not (0.0 <= value < float("inf") or value == getattr(Conditions, name)):
                remedy = "Give a finite number of at least 0."
                raise InputError(f"{value}", f"{where}, conditions.{name}", remedy)
        if self.ego_velocity_m_s is not None and not (np.abs(self.ego_velocity_m_s) <= FASTEST_M_S).all():
            what, remedy = f"{self.ego_velocity_m_s}", f"Repair the poses: give at most {FASTEST_M_S:g} m/s, or None."
            raise InputError(what, f"{where}, conditions.ego_velocity_m_s", remedy)


@dataclass(frozen=True)
class Scene:
    """One sweep in the `scene` frame: origin at the main LiDAR, x forward, y left, z up, metres.

    Attributes:
        scene_id: unique name within its data set.
        dataset: "kitti", "street-hdl64", "street-waymo_top", ...
        points: (N, 3) float32. A point at its own origin (zero range) carries no beam: see :attr:`has_beam`.
        origins: (N, 3) float32, start of each point's beam at its sensor; may be a view of one row.
        ground_z_m: nominal height of the ground around the sensor (-1.73 for KITTI).
        labels: objects in the scene.
        reflectance: (N,) float32 in 0..1, or None.
        return_number: (N,) uint8, 0 for the first return of a beam, or None.
        time_s: (N,) float32, firing time after the sweep's start, or None.
        range_image_index: (N, 2) int32, row (top beam is 0) and column of each point, or None.
        conditions: weather and the like.
        sensor: stated facts of the sensor, or None.
        no_return: no-return beams if the scene is a whole range image; None: unknown.
        in_no_label_zone: (N,) bool, points where the data set labels nothing; None: it labels everywhere.
        ground_map: the ground of the data set's map, or None.

    Source: our choice (design sections 4 and 6: beams come from each sensor's own origin).
    """

    scene_id: str
    dataset: str
    points: NDArray[np.float32]
    origins: NDArray[np.float32]
    ground_z_m: float
    labels: Labels = field(default_factory=Labels)
    reflectance: NDArray[np.float32] | None = None
    return_number: NDArray[np.uint8] | None = None
    time_s: NDArray[np.float32] | None = None
    range_image_index: NDArray[np.int32] | None = None
    conditions: Conditions = field(default_factory=Conditions)
    sensor: SensorModel | None = None
    no_return: NoReturnBeams | None = None
    in_no_label_zone: NDArray[np.bool_] | None = None
    ground_map: GroundMap | None = None

    @property
    def has_beam(self) -> NDArray[np.bool_]:
        """Mask (N,) of the points away from their origin. The other points keep their row but have no direction."""
        mask: NDArray[np.bool_] = (self.points != self.origins).any(axis=1)
        return mask

    def validate(self) -> None:
        """Refuse a scene that cannot be rendered into.

        Checks shapes, dtypes and finite values of all fields, origins within 10 km, at least one point with a beam,
        labels and conditions.
        Raises InputError: naming scene, field, row and remedy.
        """
        where = f"scene {self.scene_id}"
        if not self.scene_id or not self.dataset:
            raise InputError("empty scene_id or dataset", where, "Name both.")
        if self.points.ndim != 2 or self.points.shape[1:] != (3,):
            raise InputError(f"shape {self.points.shape}", f"{where}, points", "Give (N, 3).")
        if not len(self.points):
            raise InputError("no points", f"{where}, points", "Use another frame.")
        for name, values, dtype, columns in self._fields():
            shape = (len(self.points),) if columns is None else (len(self.points), columns)
            require_array(values, shape, dtype, f"{where}, {name}")
            if np.issubdtype(dtype, np.floating):
                refuse_not_finite(values, f"{where}, {name}", "Repair or drop those rows in the file.")
        if (far := np.abs(self.origins).max(axis=1) > FARTHEST_M).any():
            row = int(far.argmax())
            what = f"the beam of row {row} starts at {self.origins[row].tolist()} m"
            raise InputError(what, f"{where}, origins", "Repair the pose of its sensor.")
        if not np.isfinite(self.ground_z_m):
            raise InputError(f"{self.ground_z_m}", f"{where}, ground_z_m", "Give a finite height in metres.")
        if not self.has_beam.any():
            raise InputError("no point with a positive range", f"{where}, points", "Use another frame.")
        if self.reflectance is not None and (beyond := (self.reflectance < 0) | (self.reflectance > 1)).any():
            row = int(beyond.argmax())
            raise InputError(f"row {row} is {self.reflectance[row]}", f"{where}, reflectance", "Scale it to 0..1.")
        self.labels.validate(where)
        self.conditions.validate(where)
        for part in (self.sensor, self.no_return, self.ground_map):
            if part is not None:
                part.validate(where)

    def content_hash(self) -> str:
        """Compute the BLAKE2b-128 hex digest of the whole record; equal content gives equal digests on any machine.

        Arrays enter as little-endian bytes with name, dtype and shape; a broadcast view and its copy agree.
        """
        digest = hashlib.blake2b(digest_size=16)
        header = {
            "scene_id": self.scene_id,
            "dataset": self.dataset,
            "ground_z_m": float(self.ground_z_m).hex(),
            "classes": self.labels.classes,
            "names": self.labels.names,
            "conditions": _hashed(self.conditions),
            "sensor": None if self.sensor is None else _hashed(self.sensor),
        }
        if self.labels.kinds:  # the digest of scenes without kinds does not depend on this field
            header["kinds"] = self.labels.kinds
        digest.update(json.dumps(header, sort_keys=True).encode())
        arrays = [(name, values) for name, values, _, _ in self._fields()]
        arrays += [("boxes", self.labels.boxes), ("num_points", self.labels.num_points)]
        for prefix, part in (("silent", self.no_return), ("ground_map", self.ground_map)):
            if part is not None:
                arrays += [(f"{prefix}.{name}", values) for name, values in vars(part).items() if values is not None]
        for name, values in arrays:
            little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
            digest.update(f"|{name}:{little.dtype.str}:{little.shape}|".encode())
            digest.update(little.data)
        return digest.hexdigest()

    def _fields(self) -> list[tuple[str, NDArray[np.generic], type[np.generic], int | None]]:
        """List per-point arrays that are not None: name, values, required dtype, columns (None: one-dimensional)."""
        fields = ((name, getattr(self, name), dtype, columns) for name, dtype, columns in _POINT_FIELDS)
        return [field for field in fields if field[1] is not None]


def _hashed(part: Conditions | SensorModel) -> dict[str, Any]:
    """Return the values that enter a digest. A field added later enters only if it differs from its default."""
    values = asdict(part).items()
    return {name: value for name, value in values if name in _ALWAYS_HASHED or value != getattr(type(part), name)}


_ALWAYS_HASHED = (
    *("weather", "rain_mm_h", "snow_mm_h", "visibility_m", "ego_velocity_m_s", "weather_in_points"),
    *("motion_compensated", "range_noise_m", "divergence_rad", "limit_range_m", "power_spread"),
)
_POINT_FIELDS: tuple[tuple[str, type[np.generic], int | None], ...] = (
    ("points", np.float32, 3),
    ("origins", np.float32, 3),
    ("reflectance", np.float32, None),
    ("return_number", np.uint8, None),
    ("time_s", np.float32, None),
    ("range_image_index", np.int32, 2),
    ("in_no_label_zone", np.bool_, None),
)
