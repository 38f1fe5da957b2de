"""What is known about a scene beside its points: boxes with classes, and the conditions of the recording."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import validate_boxes

WEATHERS = ("dry", "rain", "fog", "snow")


@dataclass(frozen=True)
class Labels:
    """Labelled objects of one scene.

    Attributes:
        boxes: (M, 7) float64, scene frame: x, y, z of the geometric centre, dx, dy, dz, heading
            counter-clockwise from +x; metres and radians.
        classes: M names of shift3d: "vehicle", "pedestrian", "cyclist", "other".
        num_points: (M,) int32, points of the scene inside each box.
        names: M names as the data set itself gives them ("Car", "Van", ...); empty where it gives none.
        kinds: M body types with attributes ("sedan", "suv+roof_box"; "" for what is no vehicle); empty where unknown.
    """

    boxes: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 7)))
    classes: tuple[str, ...] = ()
    num_points: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    names: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()

    def of_class(self, name: str) -> NDArray[np.float64]:
        """Boxes (K, 7) of one class, in label order."""
        return self.boxes[self.mask(name)]

    def mask(self, name: str) -> NDArray[np.bool_]:
        """(M,) bool: which labels are of one class."""
        return np.array([label == name for label in self.classes], dtype=np.bool_)

    def validate(self, where: str) -> None:
        """Refuse labels that do not fit together.

        Args:
            where: the scene, named in the error.

        Raises InputError: naming the field, the row and the remedy.
        """
        validate_boxes(self.boxes, f"{where}, labels.boxes")
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
            raise InputError(
                f"row {row} is {self.num_points[row]}", f"{where}, labels.num_points", "Counts start at 0."
            )


@dataclass(frozen=True)
class Conditions:
    """What an effect may ask about the recording.

    Attributes:
        weather: one of :data:`WEATHERS`.
        rain_mm_h: rain rate; 0 where it does not rain.
        snow_mm_h: rate of snowfall as melted water; 0 where it does not snow.
        visibility_m: meteorological optical range; infinite in clear air.
        ego_velocity_m_s: (vx, vy, vz) of the sensor in the scene frame; None where unknown.
        weather_in_points: whether the points carry the weather already, as those of a recording do. Effects then
            change the object's points alone.
        motion_compensated: whether points are given where they were at time 0 in the frame of the sensor at time 0
            (origins then follow the sensor); otherwise each is given in the frame of the sensor as it fired.
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
            raise InputError(
                f"unknown weather {self.weather!r}",
                f"{where}, conditions.weather",
                f"Choose from {', '.join(WEATHERS)}.",
            )
        for name in ("rain_mm_h", "snow_mm_h"):
            rate = getattr(self, name)
            if not 0.0 <= rate < float("inf"):
                raise InputError(f"{rate} mm/h", f"{where}, conditions.{name}", "Give a finite rate of at least 0.")
        if not self.visibility_m > 0.0:
            raise InputError(
                f"{self.visibility_m} m", f"{where}, conditions.visibility_m", "Give a positive distance (inf: clear)."
            )
        if self.ego_velocity_m_s is not None and not np.isfinite(self.ego_velocity_m_s).all():
            raise InputError(
                f"{self.ego_velocity_m_s}", f"{where}, conditions.ego_velocity_m_s", "Give finite numbers, or None."
            )
