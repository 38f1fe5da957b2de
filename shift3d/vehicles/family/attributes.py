"""Attributes of vehicles of the wide family: the body types that can carry each, and the ranges of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shift3d.vehicles.family.parts import damage
from shift3d.vehicles.family.parts import roof as roof_parts
from shift3d.vehicles.family.parts import tail as tail_parts
from shift3d.vehicles.family.parts.part import Part, roof_half_width_m, roof_z_m, side_half_m, x_behind_nose
from shift3d.vehicles.family.spec import VehicleSpec

Draw = Callable[[VehicleSpec, np.random.Generator], tuple[VehicleSpec, tuple[Part, ...]]]
_WITH_TAILGATE = ("hatchback", "beach_wagon", "suv", "minivan", "van", "city_car", "kei_car")
_CARS = ("coupe", "sports_car", "suv", "beach_wagon", "sedan", "hatchback", "city_car", "minivan")
_EVERY_CAR = (*_CARS, "convertible", "van", "pickup")


@dataclass(frozen=True)
class Attribute:
    """An attribute. place: a vehicle has at most one attribute per place. carriers: body types that can have it.

    draw: returns the vehicle, changed if the attribute changes the vehicle itself, and the parts to add.
    """

    place: str
    carriers: tuple[str, ...]
    draw: Draw


def _rails(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    start, end = car.roof_front_s_m + 0.15, car.roof_rear_s_m - 0.05
    return car, (roof_parts.RoofRails(start, end, rng.uniform(0.04, 0.07)),)  # rise: from side views


def _rack(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    # Makers' data sheets: trays of 1.2 to 2.1 m, 8 to 14 cm above the roof.
    span = car.roof_rear_s_m - car.roof_front_s_m - 0.10
    length = min(rng.uniform(1.2, 2.1), span)
    start = car.roof_front_s_m + 0.05 + rng.uniform(0.0, 1.0) * (span - length)
    half = min(rng.uniform(0.50, 0.64), roof_half_width_m(car) + 0.05)
    rise, rim = rng.uniform(0.08, 0.14), rng.uniform(0.07, 0.12)
    return car, (roof_parts.RoofRack(start, start + length, half, rise, rim, int(rng.integers(5, 9))),)


def _ladder(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    # Makers' data sheets: closed two-section ladders are 2.2 to 3.6 m long and 35 to 45 cm wide.
    length = min(rng.uniform(2.2, 3.6), car.roof_rear_s_m - car.roof_front_s_m + 0.6)
    end = car.roof_rear_s_m + rng.uniform(-0.2, 0.1)
    y = rng.uniform(-1.0, 1.0) * (roof_half_width_m(car) - 0.30)
    return car, (roof_parts.Ladder(end - length, end, y, rng.uniform(0.175, 0.225), rng.uniform(0.12, 0.20)),)


def _roof_box(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    # Makers' data sheets: 1.4 to 2.35 m long, 0.55 to 0.95 m wide, 0.33 to 0.47 m high.
    length, width = rng.uniform(1.4, 2.35), rng.uniform(0.58, 0.95)
    length = min(length, 0.46 * car.length_m)
    middle = 0.5 * (car.roof_front_s_m + car.roof_rear_s_m) - rng.uniform(0.0, 0.15)
    room = max(roof_half_width_m(car) - width / 2 - 0.05, 0.0)
    part = roof_parts.RoofBox(
        from_s_m=middle - length / 2, length_m=length, width_m=width, box_height_m=rng.uniform(0.33, 0.47),
        rise_m=rng.uniform(0.06, 0.10), y_m=room * rng.uniform(-1.0, 1.0), taper_m=rng.uniform(0.35, 0.65),
    )  # fmt: skip
    return car, (part,)


def _spare_wheel(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    radius = car.wheel_radius_m * rng.uniform(0.94, 1.0)
    z = car.clearance_m + 0.25 + radius + rng.uniform(0.05, 0.25)
    return car, (tail_parts.SpareWheel(radius, rng.uniform(0.20, 0.26), rng.uniform(-0.2, 0.2), z),)


def _bicycles(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    # Wheels of 26 to 29 inches, wheelbases of 1.00 to 1.12 m, carriers for two or three bicycles 18 to 22 cm apart.
    part = tail_parts.Bicycles(
        count=int(rng.integers(1, 4)), gap_m=rng.uniform(0.22, 0.32), pitch_m=rng.uniform(0.18, 0.22),
        wheel_radius_m=rng.uniform(0.32, 0.35), base_m=rng.uniform(1.00, 1.12), rail_z_m=rng.uniform(0.50, 0.72),
        y_m=rng.uniform(-0.08, 0.08),
    )  # fmt: skip
    return car, (part,)


def _open_tailgate(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    if car.body_type == "pickup":
        return car, (tail_parts.LetDownGate(rng.uniform(0.45, 0.58)),)
    floor = max(car.clearance_m + 0.34, 0.48 * car.deck_z_m + 0.12) + rng.uniform(0.0, 0.06)
    drop = car.height_m - car.roof_drop_m - floor
    gate = float(np.hypot(drop, car.length_m - car.roof_rear_s_m)) * rng.uniform(0.88, 0.96)
    return car, (tail_parts.OpenTailgate(gate, rng.uniform(0.05, 0.50), floor, rng.uniform(0.9, 1.3)),)


def _canopy(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    return car, (tail_parts.Canopy(rng.uniform(0.0, 0.06), rng.uniform(0.05, 0.35)),)


def _lifted(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    # Makers' data sheets: kits of 4 to 12 inches, tyres of 33 to 38 inches.
    lift, radius = rng.uniform(0.18, 0.32), rng.uniform(0.42, 0.485)
    raised = {name: getattr(car, name) + lift for name in ("clearance_m", "height_m", "nose_z_m", "cowl_z_m")}
    raised |= {name: getattr(car, name) + lift for name in ("deck_z_m", "tail_z_m")}
    front = max(car.front_axle_s_m, radius + 0.14)
    return replace(car, **raised, wheel_radius_m=radius, front_axle_s_m=front, arch_gap_m=0.09), ()


def _dented(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    """Crush one corner and dent the sides. Each side keeps an undented part, so that the vehicle's size stays."""
    half = car.width_m / 2
    side = float(rng.choice((-1.0, 1.0)))
    balls = []
    end = float(rng.choice((-1.0, 1.0)))
    radius, depth = rng.uniform(0.40, 0.60), rng.uniform(0.30, 0.42)
    reach = (radius - depth) / np.sqrt(2.0)
    corner = (end * (car.length_m / 2 - 0.05 + reach), side * (half - 0.10 + reach))
    balls.append((*corner, rng.uniform(0.5, 0.8) * car.cowl_z_m, radius))
    for _ in range(int(rng.integers(2, 5))):
        radius, depth = rng.uniform(0.35, 0.70), rng.uniform(0.09, 0.18)
        s = rng.uniform(0.32, 0.78) * car.length_m
        z = rng.uniform(0.55, 0.95) * car.cowl_z_m
        where = float(rng.choice((-1.0, 1.0)))
        balls.append((x_behind_nose(car, s), where * (side_half_m(car, z) - depth + radius), z, radius))
    if car.body_type not in ("convertible",):
        radius, depth = rng.uniform(0.6, 0.9), rng.uniform(0.08, 0.14)
        s = car.roof_rear_s_m if rng.random() < 0.5 else car.roof_front_s_m
        top = roof_z_m(car, s) - depth + radius
        balls.append((x_behind_nose(car, s), side * 0.8 * roof_half_width_m(car), top, radius))
    return car, (damage.Dents(tuple((float(x), float(y), float(z), float(r)) for x, y, z, r in balls)),)


def _missing_panels(car: VehicleSpec, rng: np.random.Generator) -> tuple[VehicleSpec, tuple[Part, ...]]:
    large = ["hood", "front_door_left", "front_door_right"]
    small = ["front_fender_left", "front_fender_right", "bumper"]
    if car.body_type in ("van", "minivan"):
        large.remove("hood")  # too short for a visible gap
    first = str(rng.choice(large))
    more = [name for name in (*large, *small) if name != first]
    extra = rng.choice(more, size=int(rng.integers(1, 3)), replace=False)
    chosen = {first, *(str(name) for name in extra)}
    return car, (damage.MissingPanels(tuple(name for name in damage.PANELS if name in chosen)),)


ATTRIBUTES: dict[str, Attribute] = {
    "roof_rails": Attribute("roof", ("suv", "beach_wagon", "minivan"), _rails),
    "roof_rack": Attribute("roof", ("suv", "beach_wagon", "minivan", "van", "hatchback"), _rack),
    "ladder": Attribute("roof", ("van", "high_roof_van"), _ladder),
    "spare_wheel": Attribute("tail", ("suv",), _spare_wheel),
    "canopy": Attribute("tail", ("pickup",), _canopy),
    "roof_box": Attribute("roof", ("suv", "beach_wagon", "sedan", "hatchback", "city_car", "minivan"), _roof_box),
    "tail_bicycles": Attribute("tail", _CARS, _bicycles),
    "open_tailgate": Attribute("tail", (*_WITH_TAILGATE, "pickup"), _open_tailgate),
    "lifted": Attribute("stance", ("pickup",), _lifted),
    "dented": Attribute("body", _EVERY_CAR, _dented),
    "missing_panels": Attribute("body", _EVERY_CAR, _missing_panels),
}
