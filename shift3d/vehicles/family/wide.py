"""Wide family: vehicles of all body types and attributes, densely sized, each a closed mesh of stated size.

Length, width, height, wheelbase, ground clearance and tyres span the published range of the body type (makers' data
sheets, `published`). Shares of length and height are our choice, read off side views: for the embedded body types the
embedded ranges, each extended to 1.5 times its width; for the others the values of ``ranges.csv`` (box vans and
campers: shares of the cab's height).

The embedded family stays unchanged bit for bit beside it, because the shipped decoder was trained on that family.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.vehicles.family.attributes import ATTRIBUTES
from shift3d.vehicles.family.bodies import Alcove, BoxBody, Trailer
from shift3d.vehicles.family.embedded import ALL_RANGES, RANGES, Ranges, draw_spec
from shift3d.vehicles.family.parts.part import Part
from shift3d.vehicles.family.published import TRAILERS, published_range
from shift3d.vehicles.family.solid import Grid, car_field, half_grid, mirrored, sized_mesh
from shift3d.vehicles.family.spec import VehicleSpec
from shift3d.vehicles.family.split import SPLIT, WIDE_BODY_TYPES

_PUBLISHED = ("length_m", "width_m", "height_m", "wheelbase_m", "clearance_m")
_WIDENED = (
    "nose_of_height", "cowl_of_length", "cowl_of_height", "roof_front_of_length", "roof_rear_of_length", "roof_drop_m",
    "backlight_of_length", "deck_of_height", "tail_of_height", "tumblehome_m",
)  # fmt: skip
WIDENED = 0.25  # share of its width by which an embedded range of proportions is extended at either end
BOXES = ("box_van", "camper")
_CAB_M: Ranges = {"width_m": (2.00, 2.05), "height_m": (2.12, 2.32)}  # cab of BOXES, without the body
_TRAILER_M: Ranges = {
    name: (min(values), max(values))
    for name, values in zip(("length_m", "width_m", "height_m"), list(zip(*TRAILERS))[1:], strict=True)
} | {"drawbar_m": (1.10, 1.45), "floor_m": (0.45, 0.62), "wheel_radius_m": (0.26, 0.32)}
"""Ranges of outer length, width and height (makers' data sheets); of drawbar, floor and wheels (ours)."""
Side = Literal["seen", "held_out"]
CYCLE = (
    "hatchback", "suv", "sedan", "beach_wagon", "city_car", "suv", "van", "coupe", "hatchback", "minivan", "sedan",
    "pickup", "hatchback", "suv", "beach_wagon", "sports_car", "city_car", "sedan", "convertible", "hatchback",
)  # fmt: skip
"""Body types of seen vehicles in turn; common types come more often (our choice)."""
NO_ATTRIBUTE, TWO_ATTRIBUTES = 0.6, 0.15
"""Share of seen vehicles without an attribute; share of the others that get a second attribute (our choice)."""
_TRIES = 200
_STUBBY = ("kei_car", "city_car")
"""Short cars with wheels at their corners. They get half of the plan-view roundness of longer cars."""


@dataclass(frozen=True)
class WideSpec:
    """Specification of one vehicle of the wide family, metres.

    Attributes:
        body_type: of `split.WIDE_BODY_TYPES`. attributes: names of `attributes.ATTRIBUTES`, in drawing order.
        chassis: the vehicle on its wheels; for box vans and campers the cab and the frame.
        parts: parts to add or cut out, in order.
    """

    body_type: str
    attributes: tuple[str, ...]
    chassis: VehicleSpec | Trailer
    parts: tuple[Part, ...] = ()

    @property
    def kind(self) -> str:
        """Body type and attributes in one word, e.g. "sedan", "suv+roof_box"."""
        return "+".join((self.body_type, *self.attributes))

    @property
    def bounds_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Low and high corner in metres; the origin is on the ground at the middle of the chassis."""
        half = np.array([self.chassis.length_m / 2, self.chassis.width_m / 2])
        low, high = np.array([*-half, 0.0]), np.array([*half, self.chassis.height_m])
        if isinstance(self.chassis, VehicleSpec):
            for part in self.parts:
                corner = part.bounds(self.chassis)
                low, high = np.minimum(low, corner[0]), np.maximum(high, corner[1])
        return low, high

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height in metres, parts included."""
        low, high = self.bounds_m
        return float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2])


def draw_wide(body_type: str, attributes: tuple[str, ...], rng: np.random.Generator) -> WideSpec:
    """Draw one vehicle of a body type with attributes, with sizes from published ranges.

    Args:
        body_type: of `WIDE_BODY_TYPES`. attributes: names that this body type can carry, at most one per place.
        rng: the only source of randomness.
    Raises: InputError for an unknown name, or an attribute that the body type cannot carry.
    Source: our choice: the paper takes its vehicles from ShapeNet.
    """
    _check(body_type, attributes)
    if body_type == "trailer":
        return WideSpec(body_type, (), _draw_trailer(rng))
    car = _draw_car(body_type, rng)
    parts: tuple[Part, ...] = ()
    if body_type in BOXES:
        parts = _draw_box(car, rng)
    for name in attributes:
        car, more = ATTRIBUTES[name].draw(car, rng)
        parts += more
    return WideSpec(body_type, attributes, car, parts)


def _check(body_type: str, attributes: tuple[str, ...]) -> None:
    if body_type not in WIDE_BODY_TYPES:
        raise InputError(f"unknown body type {body_type!r}", "body_type", f"Choose from {', '.join(WIDE_BODY_TYPES)}")
    for name in attributes:
        if name not in ATTRIBUTES:
            raise InputError(f"unknown attribute {name!r}", "attributes", f"Choose from {', '.join(ATTRIBUTES)}")
        if body_type not in ATTRIBUTES[name].carriers:
            what, carriers = f"a {body_type} has no {name}", ", ".join(ATTRIBUTES[name].carriers)
            raise InputError(what, "attributes", f"Give it to {carriers}")
    places = [ATTRIBUTES[name].place for name in attributes]
    if len(set(places)) < len(places):
        raise InputError(f"{', '.join(attributes)} at one place", "attributes", "Give one a place")


def wide_ranges(body_type: str) -> Ranges:
    """Return the ranges of a body type. For box vans and campers all but length and wheelbase refer to the cab."""
    low, high = published_range(body_type, "tyre_diameter_m")
    size = {name: published_range(body_type, name) for name in _PUBLISHED} | {"wheel_radius_m": (low / 2, high / 2)}
    if body_type in BOXES:
        size |= _CAB_M
    proportions = dict(ALL_RANGES[body_type])
    for name in _WIDENED if body_type in RANGES else ():
        low, high = proportions[name]
        more, most = WIDENED * (high - low), 0.993 if name.endswith("_of_length") else float("inf")
        proportions[name] = (max(low - more, 0.0), min(high + more, most))
    return proportions | size


def _draw_car(body_type: str, rng: np.random.Generator) -> VehicleSpec:
    """Draw until wheels, hood and roof fit: ranges of different models do not fit in every combination."""
    ranges = wide_ranges(body_type)
    for _ in range(_TRIES):
        car = draw_spec(body_type, ranges, rng)
        if body_type in _STUBBY:
            half = {name: 0.5 * getattr(car, name) for name in ("front_bow_m", "rear_bow_m", "plan_taper_m")}
            car = replace(car, **half)
        if _fits(car):
            return car
    raise InputError(f"no {body_type} fits its ranges", "wide_ranges", "Widen the ranges of its length or wheelbase")


def _fits(car: VehicleSpec) -> bool:
    line = (0.0, car.cowl_s_m, car.roof_front_s_m, car.roof_rear_s_m, car.backlight_s_m, car.length_m)
    rear_overhang = car.length_m - car.front_axle_s_m - car.wheelbase_m
    reach = car.wheel_radius_m + car.arch_gap_m + 0.06
    return (
        all(b - a > 0.02 for a, b in itertools.pairwise(line))
        and car.roof_rear_s_m - car.roof_front_s_m > 0.5
        and min(car.front_axle_s_m, rear_overhang) > reach
        and car.cowl_z_m > 2.0 * car.wheel_radius_m + 0.05
        and car.height_m - car.cowl_z_m > 0.30
    )


def _draw_box(car: VehicleSpec, rng: np.random.Generator) -> tuple[Part, ...]:
    width, top = (rng.uniform(*published_range(car.body_type, name)) for name in ("width_m", "height_m"))
    gap = rng.uniform(0.04, 0.12) if car.body_type == "box_van" else -0.10
    floor = max(car.deck_z_m - 0.08, 2.0 * car.wheel_radius_m + 0.06) if car.body_type == "box_van" else 0.42
    edge = rng.uniform(0.02, 0.05) if car.body_type == "box_van" else rng.uniform(0.06, 0.12)
    box = BoxBody(car.backlight_s_m + gap, width, floor, top, edge)
    if car.body_type == "box_van":
        return (box,)
    return box, Alcove(rng.uniform(0.45, 0.85), rng.uniform(0.35, 0.75), box)


def _draw_trailer(rng: np.random.Generator) -> Trailer:
    size = rng.uniform()

    def draw(name: str, tied: float = 0.0) -> float:
        span = _TRAILER_M[name]
        return float(span[0] + (span[1] - span[0]) * (tied * size + (1.0 - tied) * rng.uniform()))

    length = draw("length_m", 0.7)
    return Trailer(
        length_m=length, width_m=draw("width_m", 0.6), height_m=draw("height_m", 0.4),
        drawbar_m=draw("drawbar_m"), floor_m=draw("floor_m"), wheel_radius_m=draw("wheel_radius_m"),
        axles=2 if length > 4.8 else 1, edge_m=rng.uniform(0.02, 0.08),
    )  # fmt: skip


def wide_vehicle(index: int, seed: int, side: Side = "seen") -> WideSpec:
    """Draw vehicle `index` of a side of the split; the result depends on (side, seed, index) alone.

    Seen: body types in the order of CYCLE, with random seen attributes. Held out: the held-out names in turn, an
    attribute on a seen body type that can carry it, so that each vehicle has one thing unknown to training.
    Raises: InputError for an unknown side. Source: our choice.
    """
    if side not in ("seen", "held_out"):
        raise InputError(f"unknown side {side!r}", "vehicle split", "Give seen or held_out")
    rng = generator("wide family", side, seed, index)
    if side == "seen":
        body_type = CYCLE[index % len(CYCLE)]
        return draw_wide(body_type, _seen_attributes(body_type, rng), rng)
    name = SPLIT.held_out[index % len(SPLIT.held_out)]
    if name in WIDE_BODY_TYPES:
        return draw_wide(name, (), rng)
    carriers = [body_type for body_type in ATTRIBUTES[name].carriers if body_type in SPLIT.seen]
    return draw_wide(carriers[int(rng.integers(len(carriers)))], (name,), rng)


def _seen_attributes(body_type: str, rng: np.random.Generator) -> tuple[str, ...]:
    usable = [name for name in SPLIT.attributes("seen") if body_type in ATTRIBUTES[name].carriers]
    if not usable or rng.random() < NO_ATTRIBUTE:
        return ()
    chosen = [usable[int(rng.integers(len(usable)))]]
    others = [name for name in usable if ATTRIBUTES[name].place != ATTRIBUTES[chosen[0]].place]
    if others and rng.random() < TWO_ATTRIBUTES:
        chosen.append(others[int(rng.integers(len(others)))])
    return tuple(name for name in ATTRIBUTES if name in chosen)


def wide_family(count: int, seed: int, side: Side = "seen") -> list[WideSpec]:
    """Draw the first `count` vehicles of a side; a longer family begins with the shorter one."""
    return [wide_vehicle(index, seed, side) for index in range(count)]


def build_wide_mesh(spec: WideSpec, resolution_m: float = 0.025, faces: int | None = None) -> trimesh.Trimesh:
    """Build a watertight mesh of a wide vehicle; arguments and frame as in `solid.build_mesh`.

    faces: if given, the mesh is simplified to about this many triangles (10,000 look the same in a scan).

    The mesh's box has the spec's size_m. Bars and tubes too thin for the grid are drawn 1.5 steps thick.
    Raises: InputError for a spec that cannot be built.
    """
    field = wide_field(spec, resolution_m)
    return sized_mesh(field, resolution_m, spec.size_m, faces)


def wide_field(spec: WideSpec, resolution_m: float) -> NDArray[np.float32]:
    """Build a wide vehicle on an equally spaced grid (A, B, C) that contains it: negative inside, about metres.

    Raises: InputError for a spec that cannot be built.
    """
    low, high = spec.bounds_m
    half = half_grid(low, high, resolution_m)
    whole = Grid(half.x, np.concatenate([-half.y[:0:-1], half.y]), half.z, half.step_m)
    if isinstance(spec.chassis, Trailer):
        return spec.chassis.field(whole)
    spec.chassis.validate()
    field = mirrored(car_field(half, spec.chassis))
    for part in spec.parts:
        part.apply(whole, spec.chassis, field)
    return field
