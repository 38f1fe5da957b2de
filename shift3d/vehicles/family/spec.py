"""Specification of one procedural vehicle: body type and dimensions in metres."""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass

from shift3d.errors import InputError

BODY_TYPES: tuple[str, ...] = (
    "coupe",
    "sports_car",
    "suv",
    "convertible",
    "beach_wagon",
    "sedan",
    "hatchback",
    "van",
    "pickup",
)
"""Body types of the embedded family, in the order in which the family cycles through them."""
MORE_BODY_TYPES: tuple[str, ...] = ("city_car", "minivan", "kei_car", "limousine", "high_roof_van", "box_van", "camper")
"""Further body types of the wide family. A trailer has no cab and no `VehicleSpec`."""
CAB_TYPES: tuple[str, ...] = ("pickup", "box_van", "camper")
"""Body types whose body ends behind the cab; a bed or a frame follows."""


@dataclass(frozen=True)
class VehicleSpec:
    """Dimensions of one vehicle in metres; `_s_m` counts backwards from the nose, `_z_m` up from the ground.

    The frame is the vehicle's side view: the nose is at s = 0, the tail at s = length_m.
    Source: our choice: the paper takes its vehicles from ShapeNet, whose licence forbids shipping them.
    """

    body_type: str
    length_m: float
    width_m: float
    height_m: float
    clearance_m: float
    wheelbase_m: float
    front_axle_s_m: float
    wheel_radius_m: float
    tyre_width_m: float
    arch_gap_m: float
    nose_z_m: float
    cowl_s_m: float
    cowl_z_m: float
    roof_front_s_m: float
    roof_rear_s_m: float
    roof_drop_m: float
    backlight_s_m: float
    deck_z_m: float
    tail_z_m: float
    shoulder_m: float
    tumblehome_m: float
    front_bow_m: float
    rear_bow_m: float
    plan_taper_m: float
    edge_radius_m: float
    spoiler_m: float = 0.0

    def validate(self) -> None:
        """Raise InputError naming the field if the vehicle cannot be built."""
        if self.body_type not in BODY_TYPES + MORE_BODY_TYPES:
            remedy = f"Choose from {', '.join(BODY_TYPES + MORE_BODY_TYPES)}"
            raise InputError(f"unknown body type {self.body_type!r}", "VehicleSpec.body_type", remedy)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not 0.0 <= value < 20.0:
                raise InputError(f"{value} m", where=f"VehicleSpec.{field.name}", remedy="Give a length from 0 to 20 m")
        order = [0.0, self.cowl_s_m, self.roof_front_s_m, self.roof_rear_s_m, self.backlight_s_m, self.length_m]
        if any(a >= b for a, b in itertools.pairwise(order)):
            what = "the roof line must run nose, cowl, roof front, roof rear, rear window, tail"
            raise InputError(what, where="VehicleSpec.*_s_m")
