"""Stated facts of a scene's sensor, and its no-return beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.scenes.file_checks import refuse_not_finite, require_array

LEAST_LIMIT_M, LEAST_SPREAD = 1e-3, 1e-9
"""Smallest limit of a sensor, and smallest width of a soft limit (our choice): smaller values are typing errors."""


@dataclass(frozen=True)
class SensorModel:
    """Facts of the sensor that effects ask for; None if the recording does not state them.

    Attributes:
        range_noise_m: standard deviation of a range, along the beam.
        divergence_rad: full angle of a beam's cone.
        limit_range_m: range at which a surface of albedo 0.9, at normal incidence in clear air, is just detected: least
            power 0.9 / limit_range_m^2. It belongs to the power law rho cos(incidence) / R^2, not to a data sheet.
        power_spread: width of the transition at that power, in factors of e; 0: a sharp limit.
    """

    range_noise_m: float | None = None
    divergence_rad: float | None = None
    limit_range_m: float | None = None
    power_spread: float = 0.0

    def validate(self, where: str) -> None:
        """Refuse values that no sensor has. Raises InputError: naming the field and the remedy."""
        for name, most in (("range_noise_m", 10.0), ("divergence_rad", 0.1), ("limit_range_m", 1e5)):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= most:
                raise InputError(f"{value}", f"{where}, sensor.{name}", f"Give more than 0, at most {most:g}, or None.")
        # Powers are divided by the limit's square, which is 0 for 1e-170 m, and their logarithms by the spread.
        if self.limit_range_m is not None and self.limit_range_m < LEAST_LIMIT_M:
            remedy = f"Give at least {LEAST_LIMIT_M:g} m, or None."
            raise InputError(f"{self.limit_range_m} m", f"{where}, sensor.limit_range_m", remedy)
        if not (self.power_spread == 0.0 or LEAST_SPREAD <= self.power_spread <= 10.0):
            remedy = f"Give {LEAST_SPREAD:g} to 10, or 0 for a sharp limit."
            raise InputError(f"{self.power_spread}", f"{where}, sensor.power_spread", remedy)


@dataclass(frozen=True)
class NoReturnBeams:
    """Beams of a range image without a return.

    Attributes:
        origins: (M, 3) float32, scene frame, metres; may be a view of one row.
        directions: (M, 3) float32 unit vectors.
        time_s: (M,) float32, firing times like those of the scene's points, or None.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    time_s: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.directions)

    def validate(self, where: str) -> None:
        """Refuse beams without a direction. Raises InputError: naming the field, the row and the remedy."""
        count = len(self.directions)
        wanted = (("origins", self.origins, (count, 3)), ("directions", self.directions, (count, 3)))
        for name, values, shape in (*wanted, ("time_s", self.time_s, (count,))):
            if values is not None:
                require_array(values, shape, np.float32, f"{where}, no_return.{name}")
                refuse_not_finite(values, f"{where}, no_return.{name}")
        length = np.linalg.norm(self.directions.astype(np.float64), axis=1)
        if (off := np.abs(length - 1.0) > 1e-3).any():
            what = f"row {int(off.argmax())} has length {length[off.argmax()]:.4g}"
            raise InputError(what, f"{where}, no_return.directions", "Give unit vectors.")
