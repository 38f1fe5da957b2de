"""Placement of vehicles: lanes, kerbs, car parks, and random places."""

from __future__ import annotations

import numpy as np

from shift3d.scenes.street.build.ground import Ground
from shift3d.scenes.street.build.item import FloorPlan, Item

LANE_M = 3.4
MOST_STEP_M = 0.6
_VARIANTS = 1 << 20


def add_vehicle(
    plan: FloorPlan, ground: Ground, rng: np.random.Generator, u: float, v: float, heading_road_rad: float
) -> bool:
    """Place a vehicle at road (u, v) with a heading relative to the road. Returns False if there is no room.

    Refuses steps of more than MOST_STEP_M under the vehicle, at the edge of a cutting or an embankment.
    """
    x, y = ground.to_scene(np.asarray(u), np.asarray(v))
    heading = heading_road_rad + ground.road_heading_rad
    around = np.linspace(0.0, 2 * np.pi, 9)
    if np.ptp(ground.height(x + 2.0 * np.cos(around), y + 2.0 * np.sin(around))) > MOST_STEP_M:
        return False
    heading = float(np.arctan2(np.sin(heading), np.cos(heading)))
    variant = int(rng.integers(_VARIANTS))
    return plan.place(Item("vehicle", float(x), float(y), heading, plan.slot_m(variant), variant))


def vehicles_in_lanes(plan: FloorPlan, ground: Ground, rng: np.random.Generator, mean_gap_m: float) -> None:
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
                    add_vehicle(plan, ground, rng, u, v, direction * np.pi / 2 + rng.normal(0.0, 0.05))
                v += 7.5 + rng.exponential(mean_gap_m * 0.8)


def _queue(
    plan: FloorPlan, ground: Ground, rng: np.random.Generator, mean_gap_m: float, v: float, direction: float
) -> None:
    u = -85.0 + rng.exponential(mean_gap_m)
    while u < 85.0:
        turn = rng.uniform(-np.pi, np.pi) if rng.random() < 0.04 else rng.normal(0.0, 0.03)
        heading = (0.0 if direction > 0 else np.pi) + turn
        add_vehicle(plan, ground, rng, u, v + rng.normal(0.0, 0.2), heading)
        u += 8.0 + rng.exponential(mean_gap_m)


def park_along_kerb(plan: FloorPlan, ground: Ground, rng: np.random.Generator) -> None:
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
            add_vehicle(plan, ground, rng, u + rng.normal(0.0, 0.25), v + rng.normal(0.0, 0.15), heading)


def fill_lot(plan: FloorPlan, ground: Ground, rng: np.random.Generator, occupancy: float) -> None:
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
                add_vehicle(plan, ground, rng, u, v, heading + rng.normal(0.0, 0.04))
        offset += 12.0 + aisle


def scatter_vehicles(plan: FloorPlan, ground: Ground, rng: np.random.Generator, count: int) -> None:
    """Place vehicles at any heading in driveways, yards and fields, 7 to 55 m away."""
    left = count
    for _ in range(60 * max(count, 0)):
        if left <= 0:
            return
        distance, bearing = rng.uniform(7.0, 55.0), rng.uniform(-np.pi, np.pi)
        x, y = distance * np.cos(bearing), distance * np.sin(bearing)
        u, v = ground.to_road(np.asarray(x), np.asarray(y))
        left -= add_vehicle(plan, ground, rng, float(u), float(v), rng.uniform(-np.pi, np.pi))
