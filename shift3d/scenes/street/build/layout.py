"""Layout of one street scene: the ground and the list of items on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shift3d.scenes.street.build.fleet import Fleet
from shift3d.scenes.street.build.ground import Ground, sample_waves
from shift3d.scenes.street.build.item import OWN_CAR_M, FloorPlan, Item
from shift3d.scenes.street.build.roadside import furnish_roadside
from shift3d.scenes.street.build.traffic import LANE_M, fill_lot, park_along_kerb, scatter_vehicles, vehicles_in_lanes

KINDS = ("street", "intersection", "lot", "plaza", "open")
_KIND_SHARES = (0.35, 0.22, 0.2, 0.13, 0.1)
NEAR_M = 75.0  # the number of vehicles is controlled within this distance
LEAST_VEHICLES, MOST_VEHICLES = 10, 30


@dataclass(frozen=True)
class Layout:
    """Ground and items (scene frame) of one scene."""

    ground: Ground
    items: tuple[Item, ...]


def sample_layout(rng: np.random.Generator, mount_height_m: float, fleet: Fleet) -> Layout:
    """Draw a random layout.

    street: a road with kerbside parking, buildings and gardens. intersection: the same with a side road and crossing
    traffic. lot: with a car park beside it. plaza: a car park all around. open: a country road with few objects. Every
    kind has some 12 to 32 vehicles of the fleet within 75 m, so that a detector sees all headings and distances.
    Source: our choice; the paper uses Waymo validation scenes.
    """
    kind = str(rng.choice(KINDS, p=_KIND_SHARES))
    ground = _sample_ground(kind, rng, mount_height_m)
    plan = FloorPlan(fleet.slot_m)
    x, y, length_m, width_m = OWN_CAR_M
    plan.reserve(x, y, 0.0, length_m, width_m)
    target = int(rng.integers(LEAST_VEHICLES + 2, MOST_VEHICLES - 1))
    if kind == "plaza":
        fill_lot(plan, ground, rng, occupancy=float(rng.uniform(0.1, 0.35)))
    else:
        vehicles_in_lanes(plan, ground, rng, mean_gap_m=float(rng.uniform(14.0, 45.0)))
        if kind in ("street", "intersection", "lot"):
            park_along_kerb(plan, ground, rng)
        if kind == "lot":
            fill_lot(plan, ground, rng, occupancy=float(rng.uniform(0.25, 0.7)))
    _thin_out(plan, rng, target)
    furnish_roadside(plan, ground, kind, rng)
    near = sum(item.kind == "vehicle" and np.hypot(item.x, item.y) < 60.0 for item in plan.items)
    scatter_vehicles(plan, ground, rng, max(int(rng.integers(1, 5)), LEAST_VEHICLES + 2 - near))
    return Layout(ground, tuple(plan.items))


def _sample_ground(kind: str, rng: np.random.Generator, mount_height_m: float) -> Ground:
    lanes_each_way = int(rng.choice((1, 2), p=(0.7, 0.3)))
    parking_m = 2.4 if kind in ("street", "intersection", "lot") and rng.random() < 0.75 else 0.3
    half_width = lanes_each_way * LANE_M + parking_m
    turned = rng.random() < 0.25  # the sensor's own car may be turning, or crossing the road
    heading = rng.uniform(-np.pi, np.pi) if turned or kind == "plaza" else rng.normal(0.0, 0.05)
    crossing = None
    if kind == "intersection":
        crossing = (float(rng.uniform(-25.0, 45.0)), float(rng.choice((3.6, 6.8)) + rng.uniform(0.0, 2.0)))
    lot = None
    if kind == "plaza":
        reach = rng.uniform(40.0, 70.0, 4)
        lot = (-float(reach[0]), float(reach[1]), -float(reach[2]), float(reach[3]))
    elif kind == "lot":
        side = 1.0 if rng.random() < 0.5 else -1.0
        near, deep = half_width + 2.0, float(rng.uniform(18.0, 45.0))
        start, length = float(rng.uniform(-35.0, 5.0)), float(rng.uniform(30.0, 60.0))
        v = sorted((side * near, side * (near + deep)))
        lot = (start, start + length, v[0], v[1])
    lane = LANE_M * (rng.integers(0, lanes_each_way) + 0.5)
    return Ground(
        road_heading_rad=float(heading),
        ego_v_m=0.0 if kind == "plaza" else float(-lane + rng.normal(0.0, 0.15)),
        half_width_m=float(half_width),
        sidewalk_m=float(rng.uniform(0.8, 4.0)) if kind != "open" else 1.0,
        curb_m=float(rng.uniform(0.08, 0.17)) if kind != "open" else float(rng.uniform(-0.05, 0.03)),
        crossing=crossing,
        lot=lot,
        crown=float(rng.uniform(0.0, 0.025)) if kind != "plaza" else 0.0,
        banks=(_sample_bank(rng), _sample_bank(rng)),
        waves=sample_waves(rng, float(rng.choice((0.2, 0.6, 1.0, 1.8)))),
        mount_height_m=mount_height_m,
    )


def _sample_bank(rng: np.random.Generator) -> float:
    """Draw a slope: mostly level with the road, sometimes a steep embankment."""
    return float(rng.uniform(0.1, 0.3) if rng.random() < 0.12 else np.clip(rng.normal(0.0, 0.03), -0.06, 0.1))


def _thin_out(plan: FloorPlan, rng: np.random.Generator, target: int) -> None:
    """Drop vehicles at random until at most `target` remain within NEAR_M; their floor space stays reserved."""
    near = [
        index for index, item in enumerate(plan.items) if item.kind == "vehicle" and np.hypot(item.x, item.y) < NEAR_M
    ]
    if len(near) > target:
        dropped = set(rng.permutation(near)[target:].tolist())
        plan.items = [item for index, item in enumerate(plan.items) if index not in dropped]
