"""Data-sheet dimensions of a vehicle, and their ranges among published vehicles."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shift3d.naturalness.surface import Surface
from shift3d.vehicles.family.published import INCH_M, PUBLISHED, TRAILERS

SIZE_TOLERANCE_M, RATIO_TOLERANCE = 0.03, 0.03
"""Tolerance of a decoded surface: the shipped family is off by up to 2 cm in size, in ratios by as large a share."""
LIFT_M = 12 * INCH_M  # largest lift kit on sale (makers' data sheets)
HIGHEST_FLOOR_M = 0.62  # highest floor of a box trailer, as in `family.wide`
ASYMMETRY_CM = 4.5
"""Largest natural asymmetry, our choice: no member of the wide family exceeds it, even with ladder, dents, bicycles."""
_MIDDLE_LENGTH, _MIDDLE_WIDTH = 0.3, 0.25


@dataclass(frozen=True)
class Sizes:
    """Measured dimensions. clearance_m: lowest point between all wheels, above the lowest point of all.

    asymmetry_cm: mean distance of the surface to its mirror image about the box's middle plane.
    """

    length_m: float
    width_m: float
    height_m: float
    clearance_m: float
    asymmetry_cm: float

    @property
    def width_to_length(self) -> float:
        """Width over length; infinite for zero length."""
        return self.width_m / self.length_m if self.length_m else math.inf

    @property
    def height_to_length(self) -> float:
        """Height over length; infinite for zero length."""
        return self.height_m / self.length_m if self.length_m else math.inf

    def out_of_range(self) -> tuple[str, ...]:
        """Return the names of measures outside the published range; a measure that is not finite is outside."""
        ranges = published_ranges()
        return tuple(name for name, (low, high) in ranges.items() if not low <= getattr(self, name) <= high)


def sizes_of(surface: Surface) -> Sizes:
    """Measure a vehicle's surface. Source: our choice; length, width, height and ground clearance follow ISO 612."""
    length, width, height = surface.size_m
    points = surface.points
    middle = (np.abs(points[:, 0]) < _MIDDLE_LENGTH * length) & (np.abs(points[:, 1]) < _MIDDLE_WIDTH * width)
    clearance = float(points[middle, 2].min()) if middle.any() else math.nan
    mirrored = points[::4] * (1.0, -1.0, 1.0)
    return Sizes(length, width, height, clearance, 100.0 * float(surface.distances_to(mirrored).mean()))


@functools.cache
def published_ranges() -> Mapping[str, tuple[float, float]]:
    """Return minimum and maximum of every measure among published vehicles, widened by a decoded surface's tolerance.

    Clearance: up to the highest model on the largest lift kit, or a trailer's floor. Asymmetry: see `ASYMMETRY_CM`.
    """
    models = [model for models in PUBLISHED.values() for model in models]
    sizes = np.array([(m.length_m, m.width_m, m.height_m) for m in models] + [row[1:] for row in TRAILERS])
    clearances = [model.clearance_m for model in models if model.clearance_m is not None]
    ratios = sizes[:, 1:] / sizes[:, :1]
    found = {
        name: (float(column.min()) - SIZE_TOLERANCE_M, float(column.max()) + SIZE_TOLERANCE_M)
        for name, column in zip(("length_m", "width_m", "height_m"), sizes.T)
    }
    found |= {
        name: (float(column.min()) * (1 - RATIO_TOLERANCE), float(column.max()) * (1 + RATIO_TOLERANCE))
        for name, column in zip(("width_to_length", "height_to_length"), ratios.T)
    }
    highest = max(max(clearances) + LIFT_M, HIGHEST_FLOOR_M)
    return found | {
        "clearance_m": (min(clearances) - SIZE_TOLERANCE_M, highest + SIZE_TOLERANCE_M),
        "asymmetry_cm": (0.0, ASYMMETRY_CM),
    }
