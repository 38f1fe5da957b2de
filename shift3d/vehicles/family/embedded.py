"""Embedded family: published ranges of real vehicles by body type, and vehicles drawn from them.

The ranges are those of vehicles on the market (makers' data sheets): outer size, ground clearance and wheelbase in
metres, and the roof line as shares of length and height.
"""

from __future__ import annotations

import csv
import itertools
from pathlib import Path

import numpy as np

from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.vehicles.family.spec import BODY_TYPES, CAB_TYPES, VehicleSpec

Range = tuple[float, float]
Ranges = dict[str, Range]  # ranges of one body type by name: `_m` in metres, `_of_length` and `_of_height` as shares


def _read_ranges() -> dict[str, Ranges]:
    with (Path(__file__).parent / "ranges.csv").open(encoding="utf-8", newline="") as file:
        rows = {row.pop("body_type"): row for row in csv.DictReader(file)}
    found: dict[str, Ranges] = {}
    for body_type, row in rows.items():
        spans = {name: cell.split() for name, cell in row.items() if cell}
        found[body_type] = {name: (float(low), float(high)) for name, (low, high) in spans.items()}
    return found


ALL_RANGES = _read_ranges()
"""Content of ``ranges.csv`` by body type; the wide family's additional types have proportions only."""
RANGES = {body_type: ALL_RANGES[body_type] for body_type in BODY_TYPES}


def sample_spec(body_type: str, rng: np.random.Generator) -> VehicleSpec:
    """Draw one vehicle of a body type from its ranges.

    Args:
        body_type: one of BODY_TYPES.
        rng: the only source of randomness; one size draw correlates length, width, height and wheelbase.
    Raises: InputError for an unknown body type.
    Source: our choice: the paper takes its vehicles from ShapeNet.
    """
    if body_type not in RANGES:
        raise InputError(f"unknown body type {body_type!r}", "body_type", f"Choose from {', '.join(BODY_TYPES)}")
    return draw_spec(body_type, RANGES[body_type], rng)


def draw_spec(body_type: str, ranges: Ranges, rng: np.random.Generator) -> VehicleSpec:
    """Draw one vehicle from the given ranges; see `sample_spec`."""
    size = rng.uniform()

    def draw(span: Range, tied: float = 0.0) -> float:
        return float(span[0] + (span[1] - span[0]) * (tied * size + (1.0 - tied) * rng.uniform()))

    length, width, height = draw(ranges["length_m"], 0.6), draw(ranges["width_m"], 0.5), draw(ranges["height_m"], 0.3)
    wheelbase = draw(ranges["wheelbase_m"], 0.7)
    backlight = length * draw(ranges["backlight_of_length"])
    roof_rear = length * draw(ranges["roof_rear_of_length"])
    if body_type in CAB_TYPES:
        backlight = roof_rear + rng.uniform(0.08, 0.16)
    return VehicleSpec(
        body_type=body_type, length_m=length, width_m=width, height_m=height, wheelbase_m=wheelbase,
        clearance_m=draw(ranges["clearance_m"]),
        front_axle_s_m=(length - wheelbase) * rng.uniform(0.43, 0.49),
        wheel_radius_m=draw(ranges["wheel_radius_m"], 0.4),
        tyre_width_m=0.62 * draw(ranges["wheel_radius_m"]) + rng.uniform(0.0, 0.04),
        arch_gap_m=rng.uniform(0.045, 0.065),
        nose_z_m=height * draw(ranges["nose_of_height"]),
        cowl_s_m=length * draw(ranges["cowl_of_length"]),
        cowl_z_m=height * draw(ranges["cowl_of_height"]),
        roof_front_s_m=length * draw(ranges["roof_front_of_length"]),
        roof_rear_s_m=roof_rear,
        roof_drop_m=draw(ranges["roof_drop_m"]),
        backlight_s_m=backlight,
        deck_z_m=height * draw(ranges["deck_of_height"]),
        tail_z_m=height * draw(ranges["tail_of_height"]),
        shoulder_m=rng.uniform(0.02, 0.06),
        tumblehome_m=draw(ranges["tumblehome_m"]),
        front_bow_m=rng.uniform(0.10, 0.22),
        rear_bow_m=rng.uniform(0.05, 0.12),
        plan_taper_m=rng.uniform(0.06, 0.13),
        edge_radius_m=rng.uniform(0.10, 0.18),
        spoiler_m=draw(ranges.get("spoiler_m", (0.0, 0.0))),
    )  # fmt: skip


def family(count: int, seed: int) -> list[VehicleSpec]:
    """Draw `count` different vehicles; body types take turns, so that any prefix is balanced.

    Vehicle i depends on (seed, i) alone: a longer family begins with the shorter one.
    Source: our choice: the paper is silent on how many vehicles of which type its DeepSDF saw.
    """
    turns = itertools.islice(itertools.cycle(BODY_TYPES), count)
    return [sample_spec(name, generator("vehicle family", seed, index)) for index, name in enumerate(turns)]
