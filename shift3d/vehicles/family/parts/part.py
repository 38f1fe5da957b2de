"""Interface of the parts of wide vehicles, and reference points for their placement."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family import profiles
from shift3d.vehicles.family.csg import Bounds
from shift3d.vehicles.family.solid import Grid
from shift3d.vehicles.family.spec import VehicleSpec


class Part(Protocol):
    """Part that is added to a vehicle or cut out of it; lengths in metres, frame as in `solid`."""

    def bounds(self, car: VehicleSpec) -> Bounds:
        """Return low and high corner of the added solid; for a cut, a box within the car."""
        ...

    def apply(self, grid: Grid, car: VehicleSpec, field: NDArray[np.float32]) -> None:
        """Change the field (A, B, C) on the whole grid in place."""
        ...


def x_behind_nose(car: VehicleSpec, s_m: float) -> float:
    """Return x of a place s metres behind the nose."""
    return car.length_m / 2 - s_m


def roof_z_m(car: VehicleSpec, s_m: float) -> float:
    """Return the roof's height at s; before and behind the roof, the height of its end."""
    roof = profiles.glasshouse(car)[2:5]
    return float(np.interp(s_m, [s for s, _ in roof], [z for _, z in roof]))


def roof_half_width_m(car: VehicleSpec) -> float:
    """Return the half width of the roof."""
    return float(profiles.glasshouse_half_width(car, np.array([car.height_m], np.float32))[0])


def side_half_m(car: VehicleSpec, z_m: float) -> float:
    """Return the half width of the body at height z, half way along the vehicle."""
    z = np.array([z_m], np.float32)
    if z_m > car.cowl_z_m:
        return float(profiles.glasshouse_half_width(car, z)[0])
    return float(profiles.lower_half_width(car, z)[0])


def highest_roof_m(car: VehicleSpec, from_s_m: float, to_s_m: float) -> float:
    """Return the largest roof height between two places."""
    return max(roof_z_m(car, s) for s in np.linspace(from_s_m, to_s_m, 9))
