"""The record of one LiDAR sweep that everything downstream reads."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.ground_map import GroundMap
from shift3d.scenes.labels import Conditions, Labels
from shift3d.scenes.listing import refuse_not_finite
from shift3d.scenes.sensor import NoReturnBeams, SensorModel

__all__ = ["Conditions", "Labels", "Scene"]


@dataclass(frozen=True)
class Scene:
    """One sweep in the `scene` frame: origin at the main LiDAR, x forward, y left, z up, metres.

    Attributes:
        scene_id: unique name within its data set.
        dataset: "kitti", "street-hdl64", "street-waymo_top", ...
        points: (N, 3) float32. A point at its own origin (zero range) carries no beam: see :attr:`has_beam`.
        origins: (N, 3) float32, where the beam of each point left its sensor; may be a view of one row.
        ground_z_m: nominal height of the ground around the sensor (-1.73 for KITTI).
        labels: objects in the scene.
        reflectance: (N,) float32 in 0..1, or None.
        return_number: (N,) uint8, 0 for the first return of a beam, or None.
        time_s: (N,) float32, firing time after the sweep's start, or None.
        range_image_index: (N, 2) int32, row (top beam is 0) and column of each point, or None.
        conditions: weather and the like.
        sensor: what is stated about the sensor; None: nothing.
        no_return: beams without a return, where the scene is a whole range image; None: unknown.
        in_no_label_zone: (N,) bool, points where the data set labels nothing, or None: it labels everywhere.
        ground_map: the ground as the data set's map has it, or None.

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
        """(N,) bool: points away from their origin. The others keep their row but have no direction."""
        mask: NDArray[np.bool_] = (self.points != self.origins).any(axis=1)
        return mask

    def validate(self) -> None:
        """Refuse a scene that cannot be rendered into.

        Raises InputError: naming scene, field, row and remedy. Checked are: shapes and dtypes of every field, NaN and
        infinite values, at least one point with a beam, labels and conditions.
        """
        where = f"scene {self.scene_id}"
        if not self.scene_id or not self.dataset:
            raise InputError("empty scene_id or dataset", where, "Name both.")
        if self.points.ndim != 2 or self.points.shape[1:] != (3,):
            raise InputError(f"shape {self.points.shape}", f"{where}, points", "Give (N, 3).")
        if not len(self.points):
            raise InputError("no points", f"{where}, points", "Use another frame.")
        for name, values, dtype, columns in self._fields():
            _check_field(f"{where}, {name}", values, dtype, len(self.points), columns)
        if not np.isfinite(self.ground_z_m):
            raise InputError(f"{self.ground_z_m}", f"{where}, ground_z_m", "Give a finite height in metres.")
        if not self.has_beam.any():
            raise InputError("no point with a positive range", f"{where}, points", "Use another frame.")
        if self.reflectance is not None and ((self.reflectance < 0) | (self.reflectance > 1)).any():
            row = int(np.argmax((self.reflectance < 0) | (self.reflectance > 1)))
            raise InputError(f"row {row} is {self.reflectance[row]}", f"{where}, reflectance", "Scale it to 0..1.")
        self.labels.validate(where)
        self.conditions.validate(where)
        if self.sensor is not None:
            self.sensor.validate(where)
        if self.no_return is not None:
            self.no_return.validate(where)
        if self.ground_map is not None:
            self.ground_map.validate(where)

    def content_hash(self) -> str:
        """BLAKE2b-128 hex digest of everything in the record: equal content gives equal digests anywhere.

        Arrays enter as little-endian bytes with name, dtype and shape; a broadcast view and its copy agree.
        """
        digest = hashlib.blake2b(digest_size=16)
        header = {
            "scene_id": self.scene_id,
            "dataset": self.dataset,
            "ground_z_m": float(self.ground_z_m).hex(),
            "classes": self.labels.classes,
            "names": self.labels.names,
            "conditions": asdict(self.conditions),
            "sensor": None if self.sensor is None else asdict(self.sensor),
        }
        if self.labels.kinds:  # scenes without them keep the digest that they have without this field
            header["kinds"] = self.labels.kinds
        digest.update(json.dumps(header, sort_keys=True).encode())
        arrays = [(name, values) for name, values, _, _ in self._fields()]
        arrays += [("boxes", self.labels.boxes), ("num_points", self.labels.num_points)]
        if self.no_return is not None:
            arrays += [
                (f"silent.{name}", values) for name, values in vars(self.no_return).items() if values is not None
            ]
        if self.ground_map is not None:
            parts = vars(self.ground_map).items()
            arrays += [(f"ground_map.{name}", values) for name, values in parts if values is not None]
        for name, values in arrays:
            little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
            digest.update(f"|{name}:{little.dtype.str}:{little.shape}|".encode())
            digest.update(little.data)
        return digest.hexdigest()

    def _fields(self) -> list[tuple[str, NDArray[np.generic], type[np.generic], int | None]]:
        """Per-point arrays that are present: name, values, dtype wanted, columns (None: one-dimensional)."""
        fields: list[tuple[str, NDArray[np.generic] | None, type[np.generic], int | None]] = [
            ("points", self.points, np.float32, 3),
            ("origins", self.origins, np.float32, 3),
            ("reflectance", self.reflectance, np.float32, None),
            ("return_number", self.return_number, np.uint8, None),
            ("time_s", self.time_s, np.float32, None),
            ("range_image_index", self.range_image_index, np.int32, 2),
            ("in_no_label_zone", self.in_no_label_zone, np.bool_, None),
        ]
        return [(name, values, dtype, columns) for name, values, dtype, columns in fields if values is not None]


def _check_field(
    where: str, values: NDArray[np.generic], dtype: type[np.generic], count: int, columns: int | None
) -> None:
    shape = (count,) if columns is None else (count, columns)
    if values.shape != shape:
        raise InputError(f"shape {values.shape}", where, f"Give {shape}, one row a point.")
    if values.dtype != dtype:
        raise InputError(f"dtype {values.dtype}", where, f"Cast it to {np.dtype(dtype).name}.")
    if np.issubdtype(dtype, np.floating):
        refuse_not_finite(values, where, "Repair or drop those rows in the file.")
