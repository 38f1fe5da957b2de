"""Tail parts: spare wheel, bicycles, open tailgate, a pickup's canopy or lowered gate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family import profiles
from shift3d.vehicles.family.csg import Bounds, add, block, cut, disc, drawable_radius_m, ring, rod, wedge
from shift3d.vehicles.family.parts.part import roof_half_width_m, side_half_m, x_behind_nose
from shift3d.vehicles.family.solid import Grid, smooth_max
from shift3d.vehicles.family.spec import VehicleSpec

Array = NDArray[np.float32]


@dataclass(frozen=True)
class SpareWheel:
    """Upright wheel on the tail door."""

    radius_m: float
    wheel_width_m: float
    y_m: float
    z_m: float

    def bounds(self, car: VehicleSpec) -> Bounds:
        tail, r = -car.length_m / 2, self.radius_m
        low = (tail - self.wheel_width_m, self.y_m - r, self.z_m - r)
        return low, (tail + 0.4, self.y_m + r, self.z_m + r)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        bounds, tail, half = self.bounds(car), -car.length_m / 2, self.wheel_width_m / 2
        add(grid, field, bounds, block((tail - half, self.y_m - 0.14, self.z_m - 0.14),
                                       (tail + 0.4, self.y_m + 0.14, self.z_m + 0.14), 0.03))  # fmt: skip
        add(grid, field, bounds, disc((tail - half, self.y_m, self.z_m), self.radius_m, half, 0.06, axis=0))
        hub = (tail - 2 * half, self.y_m, self.z_m)
        cut(grid, field, bounds, disc(hub, 0.6 * self.radius_m, 0.05, 0.03, axis=0))


@dataclass(frozen=True)
class Bicycles:
    """Bicycles across the tail on a carrier: wheelbase `base_m`, the first bicycle `gap_m` behind the tail."""

    count: int
    gap_m: float
    pitch_m: float
    wheel_radius_m: float
    base_m: float
    rail_z_m: float
    y_m: float

    def _x(self, car: VehicleSpec, number: int) -> float:
        return -car.length_m / 2 - self.gap_m - number * self.pitch_m

    def bounds(self, car: VehicleSpec) -> Bounds:
        reach = self.base_m / 2 + self.wheel_radius_m + TYRE_M
        top = self.rail_z_m + self.wheel_radius_m + HANDLEBAR_M + TUBE_M
        rear = self._x(car, self.count - 1) - GRIP_M
        low = (rear, self.y_m - reach, self.rail_z_m - 0.05)
        return low, (-car.length_m / 2 + 0.35, self.y_m + reach, top)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        bounds, rail = self.bounds(car), drawable_radius_m(grid, 0.03)
        for y in (-0.3, 0.3):
            end = (self._x(car, self.count - 1) - 0.05, y, self.rail_z_m)
            add(grid, field, bounds, rod((-car.length_m / 2 + 0.3, y, self.rail_z_m), end, rail))
        for number in range(self.count):
            self._bicycle(grid, field, bounds, self._x(car, number), 1.0 if number % 2 else -1.0)

    def _bicycle(self, grid: Grid, field: Array, bounds: Bounds, x: float, ahead: float) -> None:
        """Add one bicycle, front wheel towards y = ahead; fork and stays lie in the wheels' plane and hold them."""
        tube, r, half = drawable_radius_m(grid, TUBE_M), self.wheel_radius_m, self.base_m / 2
        hub = self.rail_z_m + TYRE_M + r
        rear, front = (x, self.y_m - ahead * half, hub), (x, self.y_m + ahead * half, hub)
        crank = (x, self.y_m - ahead * 0.12, hub - 0.06)
        saddle = (x, self.y_m - ahead * 0.26, hub + 0.42)
        head = (x, self.y_m + ahead * 0.36, hub + 0.40)
        bar = (x, self.y_m + ahead * 0.33, self.rail_z_m + r + HANDLEBAR_M)
        for centre in (rear, front):
            add(grid, field, bounds, ring(centre, r, drawable_radius_m(grid, TYRE_M)))
            for angle in np.linspace(0.0, np.pi, 4)[:3]:
                across = (0.0, r * float(np.cos(angle)), r * float(np.sin(angle)))
                ends = [tuple(c + sign * a for c, a in zip(centre, across, strict=True)) for sign in (-1.0, 1.0)]
                add(grid, field, bounds, rod(ends[0], ends[1], drawable_radius_m(grid, SPOKE_M)))  # type: ignore[arg-type]
        frame = [(rear, crank), (rear, saddle), (crank, saddle), (crank, head), (saddle, head), (head, front)]
        for a, b in [*frame, (head, bar)]:
            add(grid, field, bounds, rod(a, b, tube))
        add(grid, field, bounds, rod((x - GRIP_M + tube, *bar[1:]), (x + GRIP_M - tube, *bar[1:]), tube))
        add(grid, field, bounds, block((x - 0.08, saddle[1] - 0.13, saddle[2]), (x + 0.08, saddle[1] + 0.13,
                                                                               saddle[2] + 0.06), 0.02))  # fmt: skip
        low = (x - 0.06, self.y_m - half - 0.2, self.rail_z_m - 0.05)
        add(grid, field, bounds, block(low, (x + 0.06, self.y_m + half + 0.2, self.rail_z_m + 0.04), 0.01))


TUBE_M, TYRE_M, SPOKE_M = 0.02, 0.025, 0.008
"""Radii of frame tubes, of tyres, and of one rod that stands for a third of a wheel's spokes."""
GRIP_M, HANDLEBAR_M = 0.16, 0.72
"""Half length of a handlebar, turned along the frame for transport; its height above rail plus wheel radius."""


@dataclass(frozen=True)
class OpenTailgate:
    """Gate hinged at the end of the roof and swung up, with the open luggage space behind it."""

    gate_m: float
    up_rad: float
    floor_z_m: float
    depth_m: float

    def _hinge(self, car: VehicleSpec) -> tuple[float, float]:
        return x_behind_nose(car, car.roof_rear_s_m), car.height_m - car.roof_drop_m

    def bounds(self, car: VehicleSpec) -> Bounds:
        x, z = self._hinge(car)
        rear = x - self.gate_m * float(np.cos(self.up_rad)) - GATE_M * float(np.sin(self.up_rad)) / 2
        top = z + self.gate_m * float(np.sin(self.up_rad)) + GATE_M * (float(np.cos(self.up_rad)) - 1.0) / 2
        half = roof_half_width_m(car)
        return (min(rear, -car.length_m / 2), -half, self.floor_z_m), (x + 0.1, half, max(top, car.height_m))

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        x, z = self._hinge(car)
        tail, half = -car.length_m / 2, roof_half_width_m(car)
        inner = min(half, side_half_m(car, self.floor_z_m)) - 0.08
        front = tail + self.depth_m
        hollow = [(tail - 0.3, self.floor_z_m), (front, self.floor_z_m), (front, z - 0.10), (tail - 0.3, z - 0.10)]
        space = ((tail - 0.3, -inner, self.floor_z_m), (front, inner, z))
        cut(grid, field, space, wedge(hollow, -inner, inner, 0.04))
        opening = [(tail - 0.3, self.floor_z_m), (tail + 0.02, self.floor_z_m), (x - 0.02, z - 0.06), (tail - 0.3, z)]
        cut(grid, field, ((tail - 0.3, -inner, self.floor_z_m), (x, inner, z)), wedge(opening, -inner, inner, 0.02))
        cos, sin = float(np.cos(self.up_rad)), float(np.sin(self.up_rad))
        middle_x, middle_z = x - 0.5 * self.gate_m * cos, z - 0.5 * GATE_M + 0.5 * self.gate_m * sin
        thickness = max(GATE_M, 1.5 * grid.step_m) / 2
        low = (middle_x - self.gate_m / 2, -half + 0.03, middle_z - thickness)
        high = (middle_x + self.gate_m / 2, half - 0.03, middle_z + thickness)
        (bx, by, _), (tx, ty, tz) = self.bounds(car)
        add(grid, field, ((bx, by, z - 0.3), (tx, ty, tz)), block(low, high, 0.03, -self.up_rad), 0.04)


GATE_M = 0.09  # thickness of a gate


@dataclass(frozen=True)
class LetDownGate:
    """Pickup's gate, lowered to the level of the bed's floor."""

    gate_m: float

    def _floor(self, car: VehicleSpec) -> float:
        return profiles.bed(car)[1][1]

    def bounds(self, car: VehicleSpec) -> Bounds:
        half, floor, tail = car.width_m / 2 - 0.12, self._floor(car), -car.length_m / 2
        return (tail - self.gate_m, -half, floor - 0.08), (tail + 0.2, half, floor)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        half, floor, tail = car.width_m / 2 - 0.12, self._floor(car), -car.length_m / 2
        open_to = (tail + 0.4, half, car.height_m)
        cut(grid, field, ((tail - 0.5, -half, floor), open_to), block((tail - 0.5, -half, floor), open_to, 0.01))
        low, high = self.bounds(car)
        thickness = max(0.08, 1.5 * grid.step_m)
        add(grid, field, (low, high), block((low[0], low[1], floor - thickness), high, 0.02))


@dataclass(frozen=True)
class Canopy:
    """Hard top over a pickup's bed, `below_roof_m` lower than the cab; its tail leans forward."""

    below_roof_m: float
    lean_m: float

    def bounds(self, car: VehicleSpec) -> Bounds:
        half = car.width_m / 2 - 0.06
        return (-car.length_m / 2 + 0.06, -half, car.deck_z_m - 0.1), (
            x_behind_nose(car, car.roof_rear_s_m),
            half,
            car.height_m,
        )

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        low, high = self.bounds(car)
        top = car.height_m - car.roof_drop_m - self.below_roof_m
        corners = [(low[0], low[2]), (high[0], low[2]), (high[0], top), (low[0] + self.lean_m, top)]
        foot, run = high[1], top - low[2]
        lean = (foot - roof_half_width_m(car)) / run
        hull = wedge(corners, -9.0, 9.0, 0.06)

        def part(x: Array, y: Array, z: Array) -> Array:
            flank = np.abs(y) - np.float32(foot) + np.float32(lean) * np.maximum(z - np.float32(low[2]), 0)
            return smooth_max(hull(x, y, z), flank, 0.12)

        add(grid, field, (low, high), part, 0.03)
