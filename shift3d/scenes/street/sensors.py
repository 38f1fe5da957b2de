"""Beam tables of the spinning LiDARs of the procedural street, and their mounts."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Sensor:
    """Spinning LiDAR with a common origin of all beams.

    Attributes:
        name: one of :data:`BEAMS`, or of a head beside the main one.
        elevations_rad: beam elevations from the top beam down.
        columns: firings a turn. Azimuth decreases (clockwise from above) from half the view; on a full turn column 0
            looks backwards.
        mount_height_m: above the ground.
        min_range_m, max_range_m: of a return.
        range_noise_m: standard deviation along the beam.
        range_step_m: resolution of the reported range.
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
        """Compute azimuths (columns,) in (-pi, pi], decreasing; sensor frame."""
        return self.view_rad / 2.0 - self.view_rad * (np.arange(self.columns) + 0.5) / self.columns

    def firing_times_s(self) -> NDArray[np.float64]:
        """Compute firing times (columns,) after the start of the turn; a sector takes its share of turn_s."""
        a_column_s = self.turn_s * (self.view_rad / (2.0 * np.pi)) / self.columns
        return np.arange(self.columns, dtype=np.float64) * a_column_s


@dataclass(frozen=True)
class Mount:
    """Position of a sensor at the start of its turn, and its motion.

    Attributes:
        origin_m: scene frame. heading_rad: of its own forward, from the scene's +x. speed_m_s: along the scene's +x.
    """

    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_rad: float = 0.0
    speed_m_s: float = 0.0


AT_ORIGIN = Mount()


def _waymo_top_deg() -> NDArray[np.float64]:
    """Compute 64 elevations from +2.4 to -17.6 degrees, densest at the horizon, widening downwards.

    Source: range from the Waymo Open Dataset paper; the widening is in its calibrations, its law our choice.
    """
    step = 0.15 + 0.33 * np.linspace(0.0, 1.0, 63)
    step *= 20.0 / step.sum()
    return 2.4 - np.concatenate(([0.0], np.cumsum(step)))


def _by_rule_deg() -> dict[str, NDArray[np.float64]]:
    """Compute elevations by a rule. HDL-64E: 32 beams a third of a degree apart above 32 beams half a degree apart."""
    upper = 2.0 - np.arange(32) / 3.0
    return {
        "hdl64": np.concatenate((upper, upper[-1] - 0.5 - np.arange(32) * 0.5)),
        "waymo_top": _waymo_top_deg(),
        "hdl32": 32.0 / 3.0 - np.arange(32) * 4.0 / 3.0,
        "short32": np.linspace(10.0, -30.0, 32),
    }


def _read() -> dict[str, Sensor]:
    """Read the sensors of ``sensors.toml`` by name."""
    found: dict[str, dict[str, Any]] = {}
    by_rule = _by_rule_deg()
    for name, row in tomllib.loads((Path(__file__).parent / "sensors.toml").read_text(encoding="utf-8")).items():
        elevations = np.deg2rad(row.pop("elevations_deg", by_rule.get(name)))
        view_rad = float(np.deg2rad(row.pop("view_deg", 360.0)))
        own = {"name": name, "elevations_rad": tuple(float(e) for e in elevations), "view_rad": view_rad}
        found[name] = {**found.get(row.pop("base", ""), {}), **row, **own}
    return {name: Sensor(**values) for name, values in found.items()}


BEAMS = _read()
SHORT32 = BEAMS.pop("short32")
"""Short-range sensor for the corners of the car. `BEAMS`: sensors that can scan any street; unpublished noise, range
steps and losses are those of the HDL-64E (our choice)."""
HDL64, WAYMO_TOP, AV2_PAIR = BEAMS["hdl64"], BEAMS["waymo_top"], BEAMS["av2_pair"]
SENSORS = {sensor.name: sensor for sensor in (HDL64, WAYMO_TOP)}
"""Sensors with their own streets."""
_AV2_LOWER = replace(
    AV2_PAIR, name="av2_lower", elevations_rad=tuple(-elevation for elevation in reversed(AV2_PAIR.elevations_rad))
)
_AV2_APART_M = 0.115
"""Distance of the heads. Source: an Argoverse 2 log: heights of 1.640 and 1.525 m, the lower head turned about x."""
BY_NAME = {**BEAMS, SHORT32.name: SHORT32, _AV2_LOWER.name: _AV2_LOWER}
_CORNERS = ((2.0, 1.0, 45.0), (2.0, -1.0, -45.0), (-3.6, 1.0, 135.0), (-3.6, -1.0, -135.0))  # x, y, degrees


def other_heads(main: Sensor, speed_m_s: float) -> list[tuple[Sensor, Mount]]:
    """Return the other heads of a sensor with several, at the main head's mount height; none for most sensors."""
    if main.name != AV2_PAIR.name:
        return []
    return [(replace(_AV2_LOWER, mount_height_m=main.mount_height_m), Mount((0.0, 0.0, -_AV2_APART_M), 0.0, speed_m_s))]


def side_sensors(main: Sensor, count: int, speed_m_s: float) -> list[tuple[Sensor, Mount]]:
    """Return short-range sensors at the corners of the car below the main sensor, facing outwards along the diagonals.

    They share the main sensor's noise and divergence: one `SensorModel` describes the whole scene. Source: our choice.
    """
    sensor = replace(SHORT32, range_noise_m=main.range_noise_m, divergence_rad=main.divergence_rad)
    height_m = SHORT32.mount_height_m - main.mount_height_m
    return [
        (sensor, Mount((x, y, height_m), float(np.deg2rad(heading)), speed_m_s)) for x, y, heading in _CORNERS[:count]
    ]
