"""The embedded family: published ranges of real vehicles by body type, and instances drawn from them.

Ranges are those of vehicles on the market (makers' data sheets), body type by body type: outer size, ground
clearance and wheelbase in metres; the roof line as shares of length and height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.vehicles.family.spec import BODY_TYPES, CAB_TYPES, VehicleSpec

Range = tuple[float, float]


@dataclass(frozen=True)
class TypeRanges:
    """Ranges of one body type: `_m` in metres, `_of_length` and `_of_height` as shares."""

    length_m: Range
    width_m: Range
    height_m: Range
    clearance_m: Range
    wheelbase_m: Range
    wheel_radius_m: Range
    nose_of_height: Range
    cowl_of_length: Range
    cowl_of_height: Range
    roof_front_of_length: Range
    roof_rear_of_length: Range
    roof_drop_m: Range
    backlight_of_length: Range
    deck_of_height: Range
    tail_of_height: Range
    tumblehome_m: Range
    spoiler_m: Range = (0.0, 0.0)


RANGES: dict[str, TypeRanges] = {
    "coupe": TypeRanges(
        (4.40, 4.85), (1.78, 1.92), (1.32, 1.42), (0.12, 0.15), (2.58, 2.85), (0.32, 0.345), (0.47, 0.52),
        (0.30, 0.335), (0.66, 0.69), (0.425, 0.455), (0.59, 0.64), (0.04, 0.07), (0.85, 0.89), (0.69, 0.73),
        (0.66, 0.70), (0.20, 0.26), (0.0, 0.05),
    ),
    "sports_car": TypeRanges(
        (4.25, 4.70), (1.85, 2.00), (1.16, 1.28), (0.10, 0.13), (2.45, 2.72), (0.33, 0.355), (0.46, 0.52),
        (0.26, 0.36), (0.67, 0.71), (0.42, 0.47), (0.57, 0.62), (0.03, 0.055), (0.84, 0.91), (0.70, 0.75),
        (0.68, 0.73), (0.24, 0.31), (0.0, 0.14),
    ),
    "suv": TypeRanges(
        (4.50, 5.10), (1.85, 2.00), (1.65, 1.85), (0.18, 0.23), (2.65, 3.00), (0.36, 0.395), (0.52, 0.57),
        (0.24, 0.28), (0.61, 0.65), (0.345, 0.385), (0.88, 0.92), (0.05, 0.10), (0.975, 0.988), (0.62, 0.66),
        (0.60, 0.64), (0.11, 0.18),
    ),
    "convertible": TypeRanges(
        (4.00, 4.75), (1.74, 1.90), (1.24, 1.38), (0.12, 0.15), (2.40, 2.80), (0.31, 0.34), (0.48, 0.53),
        (0.30, 0.34), (0.69, 0.72), (0.415, 0.445), (0.69, 0.75), (0.05, 0.07), (0.80, 0.84), (0.70, 0.74),
        (0.65, 0.70), (0.18, 0.24),
    ),
    "beach_wagon": TypeRanges(
        (4.60, 4.95), (1.79, 1.91), (1.43, 1.53), (0.13, 0.17), (2.68, 2.90), (0.32, 0.345), (0.49, 0.54),
        (0.27, 0.30), (0.64, 0.67), (0.395, 0.425), (0.87, 0.905), (0.06, 0.10), (0.975, 0.988), (0.67, 0.70),
        (0.64, 0.67), (0.17, 0.22),
    ),
    "sedan": TypeRanges(
        (4.50, 5.00), (1.78, 1.91), (1.41, 1.50), (0.13, 0.16), (2.65, 2.95), (0.32, 0.345), (0.48, 0.53),
        (0.27, 0.30), (0.64, 0.67), (0.395, 0.425), (0.64, 0.69), (0.05, 0.08), (0.79, 0.83), (0.67, 0.71),
        (0.66, 0.70), (0.18, 0.24),
    ),
    "hatchback": TypeRanges(
        (3.80, 4.40), (1.70, 1.83), (1.42, 1.54), (0.13, 0.16), (2.45, 2.68), (0.30, 0.33), (0.49, 0.54),
        (0.24, 0.28), (0.63, 0.66), (0.380, 0.420), (0.82, 0.87), (0.06, 0.11), (0.965, 0.985), (0.67, 0.71),
        (0.62, 0.66), (0.16, 0.22),
    ),
    "van": TypeRanges(
        (4.70, 5.30), (1.89, 2.02), (1.83, 2.00), (0.15, 0.19), (2.90, 3.20), (0.33, 0.36), (0.46, 0.51),
        (0.14, 0.18), (0.56, 0.60), (0.270, 0.320), (0.945, 0.960), (0.03, 0.05), (0.985, 0.992), (0.55, 0.60),
        (0.53, 0.58), (0.07, 0.13),
    ),
    "pickup": TypeRanges(
        (5.20, 5.80), (1.85, 2.02), (1.76, 1.92), (0.20, 0.25), (3.10, 3.60), (0.375, 0.41), (0.53, 0.58),
        (0.245, 0.275), (0.61, 0.64), (0.335, 0.365), (0.50, 0.58), (0.03, 0.05), (0.54, 0.61), (0.60, 0.64),
        (0.58, 0.62), (0.12, 0.18),
    ),
}  # fmt: skip


def sample_spec(body_type: str, rng: np.random.Generator) -> VehicleSpec:
    """One vehicle of a body type, drawn from its ranges.

    Args:
        body_type: one of BODY_TYPES.
        rng: the only source of randomness; one size draw ties length, width, height and wheelbase together.
    Raises: InputError for an unknown body type.
    Source: our choice: the paper takes its vehicles from ShapeNet.
    """
    if body_type not in RANGES:
        raise InputError(
            f"unknown body type {body_type!r}", where="body_type", remedy=f"one of {', '.join(BODY_TYPES)}"
        )
    return draw_spec(body_type, RANGES[body_type], rng)


def draw_spec(body_type: str, ranges: TypeRanges, rng: np.random.Generator) -> VehicleSpec:
    """One vehicle drawn from the given ranges; see `sample_spec`."""
    size = rng.uniform()

    def draw(span: Range, tied: float = 0.0) -> float:
        return float(span[0] + (span[1] - span[0]) * (tied * size + (1.0 - tied) * rng.uniform()))

    length, width, height = draw(ranges.length_m, 0.6), draw(ranges.width_m, 0.5), draw(ranges.height_m, 0.3)
    wheelbase = draw(ranges.wheelbase_m, 0.7)
    backlight = length * draw(ranges.backlight_of_length)
    roof_rear = length * draw(ranges.roof_rear_of_length)
    if body_type in CAB_TYPES:
        backlight = roof_rear + rng.uniform(0.08, 0.16)
    return VehicleSpec(
        body_type=body_type, length_m=length, width_m=width, height_m=height, wheelbase_m=wheelbase,
        clearance_m=draw(ranges.clearance_m),
        front_axle_s_m=(length - wheelbase) * rng.uniform(0.43, 0.49),
        wheel_radius_m=draw(ranges.wheel_radius_m, 0.4),
        tyre_width_m=0.62 * draw(ranges.wheel_radius_m) + rng.uniform(0.0, 0.04),
        arch_gap_m=rng.uniform(0.045, 0.065),
        nose_z_m=height * draw(ranges.nose_of_height),
        cowl_s_m=length * draw(ranges.cowl_of_length),
        cowl_z_m=height * draw(ranges.cowl_of_height),
        roof_front_s_m=length * draw(ranges.roof_front_of_length),
        roof_rear_s_m=roof_rear,
        roof_drop_m=draw(ranges.roof_drop_m),
        backlight_s_m=backlight,
        deck_z_m=height * draw(ranges.deck_of_height),
        tail_z_m=height * draw(ranges.tail_of_height),
        shoulder_m=rng.uniform(0.02, 0.06),
        tumblehome_m=draw(ranges.tumblehome_m),
        front_bow_m=rng.uniform(0.10, 0.22),
        rear_bow_m=rng.uniform(0.05, 0.12),
        plan_taper_m=rng.uniform(0.06, 0.13),
        edge_radius_m=rng.uniform(0.10, 0.18),
        spoiler_m=draw(ranges.spoiler_m),
    )  # fmt: skip


def family(count: int, seed: int) -> list[VehicleSpec]:
    """`count` different vehicles, body types in turn so that any prefix is balanced; the same for the same seed.

    Instance i depends on (seed, i) alone: a longer family begins with the shorter one.
    Source: our choice: the paper is silent on how many vehicles of which type its DeepSDF saw.
    """
    specs = []
    for index in range(count):
        body_type = BODY_TYPES[index % len(BODY_TYPES)]
        specs.append(sample_spec(body_type, generator("vehicle family", seed, index)))
    return specs
