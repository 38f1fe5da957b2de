"""Damage: dents in a body, and missing panels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family.csg import Bounds, Point, ball, block, cut
from shift3d.vehicles.family.parts.part import side_half_m, x_behind_nose
from shift3d.vehicles.family.solid import Grid
from shift3d.vehicles.family.spec import VehicleSpec

Array = NDArray[np.float32]
PANELS = ("hood", "front_door_left", "front_door_right", "front_fender_left", "front_fender_right", "bumper")


def _whole(car: VehicleSpec) -> Bounds:
    half = car.width_m / 2
    return (-car.length_m / 2, -half, 0.0), (car.length_m / 2, half, car.height_m)


@dataclass(frozen=True)
class Dents:
    """Round dents: centre (x, y, z in the vehicle's frame) and radius, metres, of the ball that cuts each dent."""

    balls: tuple[tuple[float, float, float, float], ...]

    def bounds(self, car: VehicleSpec) -> Bounds:
        return _whole(car)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        for x, y, z, radius in self.balls:
            low: Point = (x - radius, y - radius, z - radius)
            cut(grid, field, (low, (x + radius, y + radius, z + radius)), ball((x, y, z), radius), 0.04)


@dataclass(frozen=True)
class MissingPanels:
    """Missing panels (of PANELS), which expose engine bay, cabin, wheel or crash beam."""

    panels: tuple[str, ...]

    def bounds(self, car: VehicleSpec) -> Bounds:
        return _whole(car)

    def apply(self, grid: Grid, car: VehicleSpec, field: Array) -> None:
        for panel in self.panels:
            for low, high in panel_holes(car, panel):
                cut(grid, field, (low, high), block(low, high, 0.03))


def panel_holes(car: VehicleSpec, panel: str) -> list[Bounds]:
    """Return the boxes of air in place of a panel."""
    half, sill = car.width_m / 2, car.clearance_m + 0.14
    if panel == "hood":
        inner = half - 0.24
        rear = x_behind_nose(car, max(car.cowl_s_m - 0.08, 0.55))
        floor = max(car.nose_z_m - 0.38, car.clearance_m + 0.2)
        return [((rear, -inner, floor), (x_behind_nose(car, 0.20), inner, car.cowl_z_m + 0.1))]
    if panel == "bumper":
        beam = car.clearance_m + 0.24
        front = x_behind_nose(car, 0.16)
        upper = ((front, -half, beam + 0.12), (car.length_m / 2 + 0.1, half, car.nose_z_m - 0.10))
        return [((front, -half, 0.0), (car.length_m / 2 + 0.1, half, beam)), upper]
    side = 1.0 if panel.endswith("left") else -1.0
    if panel.startswith("front_fender"):
        low_s, high_s = 0.12, car.front_axle_s_m + car.wheel_radius_m + car.arch_gap_m + 0.10
        inner, top = half - 0.26, car.nose_z_m + 0.5 * (car.cowl_z_m - car.nose_z_m)
        return [_sided(car, side, (low_s, high_s), (inner, half + 0.1), (2.0 * car.wheel_radius_m + 0.02, top))]
    start = max(car.cowl_s_m + 0.28, car.front_axle_s_m + car.wheel_radius_m + 0.12)
    end = min(start + 1.05, car.front_axle_s_m + car.wheelbase_m - car.wheel_radius_m - 0.1, car.roof_rear_s_m)
    lower = _sided(car, side, (start, end), (half - 0.55, half + 0.1), (sill, car.cowl_z_m))
    window = max(start, car.roof_front_s_m + 0.02)
    glass = (side_half_m(car, car.height_m) - 0.40, half + 0.1)
    return [lower, _sided(car, side, (window, end), glass, (car.cowl_z_m - 0.05, car.height_m - 0.16))]


def _sided(
    car: VehicleSpec, side: float, s_m: tuple[float, float], y_m: tuple[float, float], z_m: tuple[float, float]
) -> Bounds:
    y = sorted(side * value for value in y_m)
    return (x_behind_nose(car, s_m[1]), y[0], z_m[0]), (x_behind_nose(car, s_m[0]), y[1], z_m[1])
