"""Beam tables of the spinning LiDARs that the procedural street is seen with, and where they are mounted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Sensor:
    """A spinning LiDAR whose beams all leave one point.

    Attributes:
        name: one of :data:`BEAMS`, or of a head beside the main one.
        elevations_rad: beam elevations from the top beam down.
        columns: firings a turn; azimuth decreases (clockwise from above) from half the view: over a whole turn,
            column 0 looks backwards.
        mount_height_m: above the ground.
        min_range_m, max_range_m: of a return.
        range_noise_m: standard deviation along the beam.
        range_step_m: resolution the range is rounded to.
        turn_s: duration of a turn.
        drop_rate: share of returns lost at random, at any range.
        divergence_rad: full angle of a beam's cone.
        view_rad: sector of the turn, about the sensor's own forward, in which it fires.
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
    divergence_rad: float
    view_rad: float = 2.0 * np.pi

    def azimuths_rad(self) -> NDArray[np.float64]:
        """(columns,) azimuths in (-pi, pi], decreasing; sensor frame."""
        return self.view_rad / 2.0 - self.view_rad * (np.arange(self.columns) + 0.5) / self.columns

    def firing_times_s(self) -> NDArray[np.float64]:
        """(columns,) after the start of the turn; the whole turn takes turn_s, a sector its share of it."""
        a_column_s = self.turn_s * (self.view_rad / (2.0 * np.pi)) / self.columns
        return np.arange(self.columns, dtype=np.float64) * a_column_s


@dataclass(frozen=True)
class Mount:
    """Where a sensor stands at the start of its turn, and how it moves.

    Attributes:
        origin_m: scene frame. heading_rad: of its own forward, from the scene's +x. speed_m_s: along the scene's +x.
    """

    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_rad: float = 0.0
    speed_m_s: float = 0.0


AT_ORIGIN = Mount()


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
    divergence_rad=2.0e-3,  # the manual of the HDL-64E: 2 mrad
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
    divergence_rad=1.5e-3,  # not published; our choice, between the HDL-64E and sensors of twice its resolution
)

SENSORS = {sensor.name: sensor for sensor in (HDL64, WAYMO_TOP)}
"""Sensors with streets of their own."""

HDL32 = replace(
    HDL64,
    name="hdl32",
    elevations_rad=tuple(float(e) for e in np.deg2rad(32.0 / 3.0 - np.arange(32) * 4.0 / 3.0)),
    columns=1086,
    max_range_m=100.0,
    turn_s=0.05,
    divergence_rad=2.8e-3,
)
"""HDL-32E at 20 turns a second, as nuScenes drives it. Source: its manual: +10.67 to -30.67 degrees in steps of 4/3,
46 microseconds a firing, 100 m, 2.8 mrad."""

_VLP32C_DEG = (
    15.0, 10.333, 7.0, 4.667, 3.333, 2.333, 1.667, 1.333, 1.0, 0.667, 0.333, 0.0, -0.333, -0.667, -1.0, -1.333,
    -1.667, -2.0, -2.333, -2.667, -3.0, -3.333, -3.667, -4.0, -4.667, -5.333, -6.148, -7.254, -8.843, -11.31, -15.639,
    -25.0,
)  # fmt: skip

AV2_PAIR = replace(
    HDL64,
    name="av2_pair",
    elevations_rad=tuple(float(e) for e in np.deg2rad(_VLP32C_DEG)),
    columns=1808,
    max_range_m=200.0,
    divergence_rad=3.0e-3,
)
"""The upper of Argoverse 2's two VLP-32C, one upright on top of one upside down, at 10 turns a second. Source: the
sensor's manual: its table of elevations, 55.296 microseconds a firing, 200 m, 3 mrad."""

_AV2_LOWER = replace(
    AV2_PAIR, name="av2_lower", elevations_rad=tuple(-elevation for elevation in reversed(AV2_PAIR.elevations_rad))
)
_AV2_APART_M = 0.115
"""Source: the calibration of an Argoverse 2 log: heights of 1.640 and 1.525 m, the lower head turned about x."""

_PANDAR64_DEG = (
    14.882, 11.032, 8.059, 5.057, 3.04, 2.028, 1.86, 1.688, 1.522, 1.351, 1.184, 1.013, 0.846, 0.675, 0.508, 0.337,
    0.169, 0.0, -0.169, -0.337, -0.508, -0.675, -0.845, -1.013, -1.184, -1.351, -1.522, -1.688, -1.86, -2.028, -2.198,
    -2.365, -2.536, -2.7, -2.873, -3.04, -3.21, -3.375, -3.548, -3.712, -3.884, -4.05, -4.221, -4.385, -4.558, -4.72,
    -4.892, -5.057, -5.229, -5.391, -5.565, -5.726, -5.898, -6.061, -7.063, -8.059, -9.06, -9.885, -11.032, -12.006,
    -12.974, -13.93, -18.889, -24.897,
)  # fmt: skip

PANDAR64 = replace(
    HDL64,
    name="pandar64",
    elevations_rad=tuple(float(e) for e in np.deg2rad(_PANDAR64_DEG)),
    columns=1800,
    max_range_m=200.0,
    divergence_rad=2.0e-3,
)
"""Pandar64, as PandaSet drives it, at 10 turns a second. Source: its manual: the table of elevations, 0.2 degrees a
firing, 200 m; the divergence is our choice."""

BEAMS = {sensor.name: sensor for sensor in (HDL64, WAYMO_TOP, HDL32, AV2_PAIR, PANDAR64)}
"""Sensors whose beams any street can be seen with. Noise, steps of range and losses that are not said here are those of
the HDL-64E (our choice)."""

SHORT32 = Sensor(
    name="short32",
    elevations_rad=tuple(float(e) for e in np.deg2rad(np.linspace(10.0, -30.0, 32))),
    columns=525,
    mount_height_m=0.9,
    min_range_m=0.3,
    max_range_m=40.0,
    range_noise_m=0.015,
    range_step_m=0.002,
    turn_s=0.1,
    drop_rate=0.03,
    divergence_rad=2.0e-3,
    view_rad=float(np.deg2rad(210.0)),  # the rest of its turn looks at the car that carries it
)
"""A short-range sensor for the corners of the car (our choice)."""

_BY_NAME = {**BEAMS, SHORT32.name: SHORT32, _AV2_LOWER.name: _AV2_LOWER}
_CORNERS = ((2.0, 1.0, 45.0), (2.0, -1.0, -45.0), (-3.6, 1.0, 135.0), (-3.6, -1.0, -135.0))  # x, y, degrees


def sensor_named(name: str) -> Sensor:
    """One of the sensors; KeyError for an unknown name."""
    return _BY_NAME[name]


def companions(main: Sensor, speed_m_s: float) -> list[tuple[Sensor, Mount]]:
    """The other heads of a sensor that has several, at the main one's height in the scene; none for most sensors."""
    if main.name != AV2_PAIR.name:
        return []
    return [(replace(_AV2_LOWER, mount_height_m=main.mount_height_m), Mount((0.0, 0.0, -_AV2_APART_M), 0.0, speed_m_s))]


def side_sensors(main: Sensor, count: int, speed_m_s: float) -> list[tuple[Sensor, Mount]]:
    """Short-range sensors at the corners of the car under the main one, looking outwards along the diagonals.

    They share the main sensor's noise and divergence, so that one `SensorModel` describes the whole scene.

    Source: our choice.
    """
    sensor = replace(SHORT32, range_noise_m=main.range_noise_m, divergence_rad=main.divergence_rad)
    height_m = SHORT32.mount_height_m - main.mount_height_m
    return [
        (sensor, Mount((x, y, height_m), float(np.deg2rad(heading)), speed_m_s)) for x, y, heading in _CORNERS[:count]
    ]
