"""Bodies other than cars: a box behind a cab, a camper's living room with its alcove, a trailer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family.csg import Bounds, add, block, cut, disc, drawable_radius_m, pair, rod, wedge
from shift3d.vehicles.family.parts.part import x_behind_nose
from shift3d.vehicles.family.solid import Grid
from shift3d.vehicles.family.spec import VehicleSpec

Array = NDArray[np.float32]


@dataclass(frozen=True)
class BoxBody:
    """Box on the frame behind a cab, from s to the tail; wheel arches are cut out of a box that reaches the wheels."""

    from_s_m: float
    width_m: float
    floor_z_m: float
    top_z_m: float
    edge_m: float

    def bounds(self, car: VehicleSpec) -> Bounds:
        half = self.width_m / 2
        return (-car.length_m / 2, -half, self.floor_z_m), (x_behind_nose(car, self.from_s_m), half, self.top_z_m)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        low, high = self.bounds(car)
        whole = block(low, high, self.edge_m)
        axle = (x_behind_nose(car, car.front_axle_s_m + car.wheelbase_m), high[1], car.wheel_radius_m)
        arch = pair(disc(axle, car.wheel_radius_m + car.arch_gap_m, 0.50, 0.02, axis=1))
        add(grid, field, (low, high), lambda x, y, z: np.maximum(whole(x, y, z), -arch(x, y, z)))
        spine = (x_behind_nose(car, car.roof_rear_s_m) + 0.2, 0.35, self.floor_z_m + 0.5)
        start = (high[0] - 0.2, -0.35, self.floor_z_m - 0.1)
        add(grid, field, (start, spine), block(start, spine, 0.05))


@dataclass(frozen=True)
class Alcove:
    """Camper's berth over the cab, joined to the box body, with windows cut into the box's sides."""

    from_s_m: float
    slope_m: float
    box: BoxBody

    def bounds(self, car: VehicleSpec) -> Bounds:
        half = self.box.width_m / 2
        low = (x_behind_nose(car, self.box.from_s_m), -half, car.height_m - 0.15)
        return low, (x_behind_nose(car, self.from_s_m), half, self.box.top_z_m)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        (rear, low_y, floor), (front, half, top) = self.bounds(car)
        chin = floor + 0.3 * (top - floor)
        corners = [(rear - 0.3, floor), (front - 0.25, floor), (front, chin), (front - self.slope_m, top),
                   (rear - 0.3, top)]  # fmt: skip
        part = wedge(corners, low_y, half, self.box.edge_m)
        add(grid, field, ((rear - 0.3, low_y, floor), (front, half, top)), part, 0.03)
        # One window for the living room and one for the bedroom, deep enough to show on the grid.
        sill, depth = car.cowl_z_m + 0.35, 0.05
        start, end = self.box.from_s_m, car.length_m
        for share, length in ((0.22, 0.95), (0.72, 0.70)):
            x = x_behind_nose(car, start + share * (end - start))
            low, high = (x - length / 2, half - depth, sill), (x + length / 2, half + 0.2, sill + 0.52)
            bounds = ((low[0], -high[1], low[2]), high)
            cut(grid, field, bounds, pair(block(low, high, 0.03)))


@dataclass(frozen=True)
class Trailer:
    """Box trailer on one or two axles, with drawbar and jockey wheel. x forward, the drawbar's coupling in front."""

    length_m: float
    width_m: float
    height_m: float
    drawbar_m: float
    floor_m: float
    wheel_radius_m: float
    axles: int
    edge_m: float

    def field(self, grid: Grid) -> Array:
        """Build the whole trailer on a grid (A, B, C), negative inside, metres."""
        field = np.full((len(grid.x), len(grid.y), len(grid.z)), np.float32(1.0))
        front, tail, half = self.length_m / 2 - self.drawbar_m, -self.length_m / 2, self.width_m / 2
        track, tyre = half - 0.02, 0.19
        everything: Bounds = ((tail, -half, 0.0), (self.length_m / 2, half, self.height_m))
        body_half = half - 0.06
        body = block((tail, -body_half, self.floor_m), (front, body_half, self.height_m), self.edge_m)
        add(grid, field, everything, body)
        middle = (front + tail) / 2 - 0.1
        offsets = (0.0,) if self.axles == 1 else (self.wheel_radius_m + 0.04, -self.wheel_radius_m - 0.04)
        for offset in offsets:
            centre = (middle + offset, half - tyre / 2 - 0.02, self.wheel_radius_m)
            arch = disc(centre, self.wheel_radius_m + 0.06, tyre / 2 + 0.03, 0.02, axis=1)
            cut(grid, field, everything, pair(arch))
            wheel = disc(centre, self.wheel_radius_m, tyre / 2, 0.04, axis=1)
            add(grid, field, everything, pair(wheel))
            ends = ((centre[0], -centre[1], centre[2]), centre)
            add(grid, field, everything, rod(*ends, drawable_radius_m(grid, 0.04)))
            hanger = ((centre[0], track - 0.35, centre[2]), (centre[0], track - 0.35, self.floor_m + 0.1))
            add(grid, field, everything, pair(rod(*hanger, drawable_radius_m(grid, 0.05))))
            top = 2 * self.wheel_radius_m + 0.10
            low = (centre[0] - self.wheel_radius_m - 0.1, half - tyre - 0.08, top - 0.05)
            mudguard = block(low, (centre[0] + self.wheel_radius_m + 0.1, half, top + 0.02), 0.015)
            add(grid, field, everything, pair(mudguard))
        coupling, bar_z = self.length_m / 2, self.floor_m - 0.02
        tube = drawable_radius_m(grid, 0.04)
        for y in (-0.45, 0.45):
            add(grid, field, everything, rod((front - 0.4, y, bar_z), (coupling - 0.3, 0.0, bar_z), tube))
        add(grid, field, everything, rod((coupling - 0.5, 0.0, bar_z), (coupling - tube, 0.0, bar_z), tube))
        jockey = coupling - 0.35
        add(grid, field, everything, rod((jockey, 0.0, 0.2), (jockey, 0.0, bar_z + 0.3), drawable_radius_m(grid, 0.03)))
        add(grid, field, everything, disc((jockey, 0.0, 0.10), 0.10, max(0.03, tube), 0.01, axis=1))
        return field
