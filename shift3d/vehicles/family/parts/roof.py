"""Roof parts: rails, rack, ladder, luggage box."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family.csg import Bounds, add, block, drawable_radius_m, pair, rod, wedge
from shift3d.vehicles.family.parts.part import highest_roof_m, roof_half_width_m, roof_z_m, x_behind_nose
from shift3d.vehicles.family.solid import Grid, smooth_max
from shift3d.vehicles.family.spec import VehicleSpec

Array = NDArray[np.float32]
BAR_M = 0.02  # radius of rails and bars: tubes and profiles are 3 to 5 cm wide
SUNK_M = 0.08  # depth of the feet inside the roof


def _cross_bar(grid: Grid, field: Array, bounds: Bounds, car: VehicleSpec, s_m: float, y_m: float, z_m: float) -> None:
    """Add a bar across the roof at s, `y_m` to either side, with two feet."""
    x, radius = x_behind_nose(car, s_m), drawable_radius_m(grid, BAR_M)
    add(grid, field, bounds, rod((x, -y_m, z_m), (x, y_m, z_m), radius))
    add(grid, field, bounds, pair(rod((x, y_m, z_m), (x, y_m, roof_z_m(car, s_m) - SUNK_M), radius)))


@dataclass(frozen=True)
class RoofRails:
    """Rail along either edge of the roof, between two s, `rise_m` above the roof."""

    from_s_m: float
    to_s_m: float
    rise_m: float

    def bounds(self, car: VehicleSpec) -> Bounds:
        half = roof_half_width_m(car)
        top = highest_roof_m(car, self.from_s_m, self.to_s_m) + self.rise_m + BAR_M
        return (x_behind_nose(car, self.to_s_m), -half, car.cowl_z_m), (x_behind_nose(car, self.from_s_m), half, top)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        y, radius = roof_half_width_m(car) - 0.05, drawable_radius_m(grid, BAR_M)
        places = np.linspace(self.from_s_m, self.to_s_m, 4)
        line = [(x_behind_nose(car, s), y, roof_z_m(car, s) + self.rise_m) for s in places]
        bounds = self.bounds(car)
        for a, b in itertools.pairwise(line):
            add(grid, field, bounds, pair(rod(a, b, radius)))
        for x, _, z in line:
            add(grid, field, bounds, pair(rod((x, y, z), (x, y, z - self.rise_m - SUNK_M), radius)))


@dataclass(frozen=True)
class RoofRack:
    """Tray of bars on feet: `slats` bars across, a rim around them, `rise_m` above the roof at its middle."""

    from_s_m: float
    to_s_m: float
    half_m: float
    rise_m: float
    rim_m: float
    slats: int

    def _z(self, car: VehicleSpec) -> float:
        return highest_roof_m(car, self.from_s_m, self.to_s_m) + self.rise_m

    def bounds(self, car: VehicleSpec) -> Bounds:
        top = self._z(car) + self.rim_m + BAR_M
        edge = self.half_m + BAR_M
        return (x_behind_nose(car, self.to_s_m), -edge, car.cowl_z_m), (x_behind_nose(car, self.from_s_m), edge, top)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        bounds, radius, z, y = self.bounds(car), drawable_radius_m(grid, BAR_M), self._z(car), self.half_m
        front, rear = x_behind_nose(car, self.from_s_m) - BAR_M, x_behind_nose(car, self.to_s_m) + BAR_M
        for level in (z, z + self.rim_m):
            add(grid, field, bounds, pair(rod((front, y, level), (rear, y, level), radius)))
            for x in (front, rear):
                add(grid, field, bounds, rod((x, -y, level), (x, y, level), radius))
        for x in np.linspace(front, rear, self.slats):
            add(grid, field, bounds, rod((x, -y, z), (x, y, z), radius))
        for s in (self.from_s_m + 0.12, self.to_s_m - 0.12):
            x, foot = x_behind_nose(car, s), min(y, roof_half_width_m(car) - 0.08)
            add(grid, field, bounds, pair(rod((x, foot, z), (x, foot, roof_z_m(car, s) - SUNK_M), radius)))
            add(grid, field, bounds, rod((x, -y, z), (x, y, z), radius))
        for x in (front, rear):
            add(grid, field, bounds, pair(rod((x, y, z), (x, y, z + self.rim_m), radius)))


@dataclass(frozen=True)
class Ladder:
    """Ladder along the roof on two cross bars, centred at y."""

    from_s_m: float
    to_s_m: float
    y_m: float
    half_m: float
    rise_m: float

    def _z(self, car: VehicleSpec) -> float:
        start, end = max(self.from_s_m, car.roof_front_s_m), min(self.to_s_m, car.roof_rear_s_m)
        return highest_roof_m(car, start, end) + self.rise_m

    def bounds(self, car: VehicleSpec) -> Bounds:
        y = max(roof_half_width_m(car), abs(self.y_m) + self.half_m + BAR_M)
        top = self._z(car) + 2 * BAR_M
        return (x_behind_nose(car, self.to_s_m), -y, car.cowl_z_m), (x_behind_nose(car, self.from_s_m), y, top)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        bounds, radius, z = self.bounds(car), drawable_radius_m(grid, BAR_M), self._z(car)
        front, rear = x_behind_nose(car, self.from_s_m) - BAR_M, x_behind_nose(car, self.to_s_m) + BAR_M
        sides = (self.y_m - self.half_m, self.y_m + self.half_m)
        for y in sides:
            add(grid, field, bounds, rod((front, y, z + BAR_M), (rear, y, z + BAR_M), radius))
        for x in np.arange(rear + 0.1, front, 0.30):
            add(grid, field, bounds, rod((x, sides[0], z + BAR_M), (x, sides[1], z + BAR_M), radius))
        edge = roof_half_width_m(car) - 0.06
        for s in (car.roof_front_s_m + 0.35, car.roof_rear_s_m - 0.35):
            _cross_bar(grid, field, bounds, car, s, edge, z)


@dataclass(frozen=True)
class RoofBox:
    """Luggage box on two bars, centred at y; its nose tapers over `taper_m`."""

    from_s_m: float
    length_m: float
    width_m: float
    box_height_m: float
    rise_m: float
    y_m: float
    taper_m: float

    def _floor(self, car: VehicleSpec) -> float:
        return highest_roof_m(car, car.roof_front_s_m, car.roof_rear_s_m) + self.rise_m

    def bounds(self, car: VehicleSpec) -> Bounds:
        y = max(roof_half_width_m(car), abs(self.y_m) + self.width_m / 2)
        front = x_behind_nose(car, self.from_s_m)
        return (front - self.length_m, -y, car.cowl_z_m), (front, y, self._floor(car) + self.box_height_m)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        bounds, floor = self.bounds(car), self._floor(car)
        front, half, top = x_behind_nose(car, self.from_s_m), self.width_m / 2, floor + self.box_height_m
        low, high = self.y_m - half, self.y_m + half
        whole = block((front - self.length_m, low, floor), (front, high, top), 0.09)
        keel = floor + 0.35 * self.box_height_m
        nose = wedge(
            [(front - 9.0, floor - 1.0), (front + 0.3, floor - 1.0), (front + 0.02, keel), (front - self.taper_m, top),
             (front - 9.0, top)],
            low - 1.0, high + 1.0, 0.02,
        )  # fmt: skip
        add(grid, field, bounds, lambda x, y, z: smooth_max(whole(x, y, z), nose(x, y, z), 0.06))
        edge = min(max(half + abs(self.y_m), 0.4), roof_half_width_m(car) - 0.06)
        for share in (0.22, 0.78):
            s = self.from_s_m + share * self.length_m
            s = min(max(s, car.roof_front_s_m + 0.05), car.roof_rear_s_m - 0.05)
            _cross_bar(grid, field, bounds, car, s, edge, floor)
