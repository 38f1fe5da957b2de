"""Beam tables of the two spinning LiDARs that the procedural street is seen with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Sensor:
    """A spinning LiDAR whose beams all leave one point.

    Attributes:
        name: "hdl64" or "waymo_top".
        elevations_rad: beam elevations from the top beam down.
        columns: firings a turn; column 0 looks backwards, azimuth decreases (clockwise from above).
        mount_height_m: above the ground.
        min_range_m, max_range_m: of a return.
        range_noise_m: standard deviation along the beam.
        range_step_m: resolution the range is rounded to.
        turn_s: duration of a turn.
        drop_rate: share of returns lost at random, at any range.
    """

    name: str
    elevations_rad: tuple[float, ...]
    columns: int
    mount_height_m: float
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    range_step_m: float
    turn_s: float
    drop_rate: float

    def azimuths_rad(self) -> NDArray[np.float64]:
        """(columns,) azimuths in (-pi, pi], decreasing."""
        return np.pi - 2.0 * np.pi * (np.arange(self.columns) + 0.5) / self.columns


def _hdl64_elevations() -> tuple[float, ...]:
    """An upper block of 32 beams a third of a degree apart and a lower block of 32, half a degree apart."""
    upper = 2.0 - np.arange(32) / 3.0
    lower = upper[-1] - 0.5 - np.arange(32) * 0.5
    return tuple(float(e) for e in np.deg2rad(np.concatenate((upper, lower))))


def _waymo_top_elevations() -> tuple[float, ...]:
    """64 beams from +2.4 to -17.6 degrees, closest together at the horizon, widening downwards.

    Source: range from the Waymo Open Dataset paper; that the spacing widens downwards is in its calibrations,
    the law of widening is our choice.
    """
    step = 0.15 + 0.33 * np.linspace(0.0, 1.0, 63)
    step *= 20.0 / step.sum()
    return tuple(float(e) for e in np.deg2rad(2.4 - np.concatenate(([0.0], np.cumsum(step)))))


HDL64 = Sensor(
    name="hdl64",
    elevations_rad=_hdl64_elevations(),
    columns=2083,
    mount_height_m=1.73,
    min_range_m=0.9,
    max_range_m=120.0,
    range_noise_m=0.015,
    range_step_m=0.002,
    turn_s=0.1,
    drop_rate=0.03,
)

WAYMO_TOP = Sensor(
    name="waymo_top",
    elevations_rad=_waymo_top_elevations(),
    columns=2650,
    mount_height_m=2.18,
    min_range_m=0.9,
    max_range_m=75.0,
    range_noise_m=0.012,
    range_step_m=0.004,
    turn_s=0.1,
    drop_rate=0.03,
)

SENSORS = {sensor.name: sensor for sensor in (HDL64, WAYMO_TOP)}
