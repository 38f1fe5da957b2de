"""Layout of one street scene: the ground, and the items on it, vehicles in lanes, at kerbs, in car parks and fields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shift3d.scenes.street.build.fleet import Fleet
from shift3d.scenes.street.build.ground import Ground, sample_waves
from shift3d.scenes.street.build.item import OWN_CAR_M, FloorPlan, Item
from shift3d.scenes.street.build.roadside import furnish_roadside

KINDS = ("street", "intersection", "lot", "plaza", "open")
_KIND_SHARES = (0.35, 0.22, 0.2, 0.13, 0.1)
NEAR_M = 75.0  # the number of vehicles is controlled within this distance
LEAST_VEHICLES, MOST_VEHICLES = 10, 30
LANE_M = 3.4
MOST_STEP_M = 0.6
_VARIANTS = 1 << 20


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
        _fill_lot(plan, ground, rng, occupancy=float(rng.uniform(0.1, 0.35)))
    else:
        _vehicles_in_lanes(plan, ground, rng, mean_gap_m=float(rng.uniform(14.0, 45.0)))
        if kind in ("street", "intersection", "lot"):
            _park_along_kerb(plan, ground, rng)
        if kind == "lot":
            _fill_lot(plan, ground, rng, occupancy=float(rng.uniform(0.25, 0.7)))
    _thin_out(plan, rng, target)
    furnish_roadside(plan, ground, kind, rng)
    near = sum(item.kind == "vehicle" and np.hypot(item.x, item.y) < 60.0 for item in plan.items)
    _scatter_vehicles(plan, ground, rng, max(int(rng.integers(1, 5)), LEAST_VEHICLES + 2 - near))
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


def _add_vehicle(
    plan: FloorPlan, ground: Ground, rng: np.random.Generator, u: float, v: float, heading_road_rad: float
) -> bool:
    """Place a vehicle at road (u, v), unless there is no room, or a step of over MOST_STEP_M is under it."""
    x, y = ground.to_scene(np.asarray(u), np.asarray(v))
    heading = heading_road_rad + ground.road_heading_rad
    around = np.linspace(0.0, 2 * np.pi, 9)
    if np.ptp(ground.height(x + 2.0 * np.cos(around), y + 2.0 * np.sin(around))) > MOST_STEP_M:
        return False
    heading = float(np.arctan2(np.sin(heading), np.cos(heading)))
    variant = int(rng.integers(_VARIANTS))
    return plan.place(Item("vehicle", float(x), float(y), heading, plan.slot_m(variant), variant))


def _vehicles_in_lanes(plan: FloorPlan, ground: Ground, rng: np.random.Generator, mean_gap_m: float) -> None:
    """Place right-hand traffic on the road, and on the side road if there is one."""
    parking = (ground.half_width_m % LANE_M) if ground.half_width_m > LANE_M else 0.0
    lanes = max(round((ground.half_width_m - parking) / LANE_M), 1)
    for lane in range(lanes):
        for direction in (1.0, -1.0):
            _queue(plan, ground, rng, mean_gap_m, -direction * LANE_M * (lane + 0.5), direction)
    if ground.crossing is None:
        return
    middle, half = ground.crossing
    for lane in range(max(int(half // LANE_M), 1)):
        for direction in (1.0, -1.0):
            v = -75.0 + rng.exponential(mean_gap_m)
            while v < 75.0:
                if abs(v) > 2.0 or rng.random() < 0.4:
                    u = middle + direction * LANE_M * (lane + 0.5) + rng.normal(0.0, 0.2)
                    _add_vehicle(plan, ground, rng, u, v, direction * np.pi / 2 + rng.normal(0.0, 0.05))
                v += 7.5 + rng.exponential(mean_gap_m * 0.8)


def _queue(
    plan: FloorPlan, ground: Ground, rng: np.random.Generator, mean_gap_m: float, v: float, direction: float
) -> None:
    u = -85.0 + rng.exponential(mean_gap_m)
    while u < 85.0:
        turn = rng.uniform(-np.pi, np.pi) if rng.random() < 0.04 else rng.normal(0.0, 0.03)
        heading = (0.0 if direction > 0 else np.pi) + turn
        _add_vehicle(plan, ground, rng, u, v + rng.normal(0.0, 0.2), heading)
        u += 8.0 + rng.exponential(mean_gap_m)


def _park_along_kerb(plan: FloorPlan, ground: Ground, rng: np.random.Generator) -> None:
    """Park vehicles on each side: none, in line with the kerb, or at an angle to it."""
    for side in (1.0, -1.0):
        style = rng.choice(("none", "line", "angle"), p=(0.25, 0.5, 0.25))
        if style == "none":
            continue
        occupancy = rng.uniform(0.15, 0.75)
        angle = rng.choice((np.pi / 2, np.pi / 3, np.pi / 4)) * rng.choice((-1.0, 1.0)) if style == "angle" else 0.0
        pitch = 6.4 if style == "line" else 2.75 / abs(np.sin(angle))
        v = side * (ground.half_width_m + (-1.1 if style == "line" else 2.6))
        for u in np.arange(-75.0, 75.0, pitch):
            in_side_road = ground.crossing is not None and abs(u - ground.crossing[0]) < ground.crossing[1] + 4.0
            if in_side_road or rng.random() > occupancy:
                continue
            heading = angle + (np.pi if rng.random() < (0.1 if side < 0 else 0.9) else 0.0)
            heading += rng.normal(0.0, 0.03)
            _add_vehicle(plan, ground, rng, u + rng.normal(0.0, 0.25), v + rng.normal(0.0, 0.15), heading)


def _fill_lot(plan: FloorPlan, ground: Ground, rng: np.random.Generator, occupancy: float) -> None:
    """Fill rows of slots across the car park, the rows at any angle to the road, vehicles nose in or out."""
    if ground.lot is None:
        return
    u0, u1, v0, v1 = ground.lot
    middle, reach = np.array([(u0 + u1) / 2, (v0 + v1) / 2]), np.hypot(u1 - u0, v1 - v0) / 2
    angle = rng.choice((0.0, np.pi / 2, rng.uniform(0.0, np.pi)))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    aisle, slot = rng.uniform(6.0, 8.0), rng.uniform(2.6, 3.0)
    skew = rng.choice((0.0, 0.0, np.pi / 6, -np.pi / 6))
    offset = -reach + rng.uniform(0.0, 5.0)
    while offset < reach:
        for row in (offset, offset + 6.0):
            for s in np.arange(-reach, reach, slot / np.cos(skew)):
                u, v = middle + s * along + row * across
                inside = u0 + 2.5 < u < u1 - 2.5 and v0 + 2.5 < v < v1 - 2.5
                if not inside or rng.random() > occupancy:
                    continue
                heading = angle + np.pi / 2 + skew + (np.pi if rng.random() < 0.5 else 0.0)
                _add_vehicle(plan, ground, rng, u, v, heading + rng.normal(0.0, 0.04))
        offset += 12.0 + aisle


def _scatter_vehicles(plan: FloorPlan, ground: Ground, rng: np.random.Generator, count: int) -> None:
    """Place vehicles at any heading in driveways, yards and fields, 7 to 55 m away."""
    left = count
    for _ in range(60 * count):
        if left <= 0:
            return
        distance, bearing = rng.uniform(7.0, 55.0), rng.uniform(-np.pi, np.pi)
        x, y = distance * np.cos(bearing), distance * np.sin(bearing)
        u, v = ground.to_road(np.asarray(x), np.asarray(y))
        left -= _add_vehicle(plan, ground, rng, float(u), float(v), rng.uniform(-np.pi, np.pi))
