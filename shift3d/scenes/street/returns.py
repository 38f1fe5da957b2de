"""Conversion of first hits to returns (range noise, rounding, drop-out, reflectance), and of returns to scene rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.sensor import NoReturnBeams, SensorModel
from shift3d.scenes.street.raycast import Float32, Hits, Sweep
from shift3d.scenes.street.sensors import Sensor
from shift3d.scenes.street.shapes import ALBEDO, Material

Cells = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Row and column of beams, (K,) each."""

# Received power, albedo * cosine / range^2 in 1/m^2, at which half of the returns are lost, and the width of
# the transition in factors of e. The ground then fades out between 45 and 65 m, as in KITTI frames.
HALF_POWER = 2.2e-6
POWER_SPREAD = 0.45
LIMIT_RANGE_M = float(np.sqrt(0.9 / HALF_POWER))
"""Range at which a surface of albedo 0.9 at normal incidence gives HALF_POWER; see `SensorModel`."""
_ROUGHNESS_M = {Material.TERRAIN: 0.02, Material.FOLIAGE: 0.05, Material.CLOTH: 0.01}


@dataclass(frozen=True)
class Paint:
    """Paint of one vehicle: albedo of its body, and the share of beams that its windows do not return."""

    albedo: float
    glass_loss: float


def sensor_model(sensor: Sensor) -> SensorModel:
    """Return the model that `finish` applies, except range scatter of rough surfaces and loss by drop_rate."""
    return SensorModel(
        range_noise_m=sensor.range_noise_m,
        divergence_rad=sensor.divergence_rad,
        limit_range_m=LIMIT_RANGE_M,
        power_spread=POWER_SPREAD,
    )


def finish(
    sweep: Hits, paint: dict[int, Paint], rng: np.random.Generator, share: NDArray[np.float64] | float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Compute ranges as a sensor reports them.

    Args:
        sweep: first hits of every beam.
        paint: of vehicles, by item number; other objects have their material's albedo.
        share: share of each beam's light that gets there and back; the rest met something in front.

    Returns: range_m, reflectance (both float32) and kept (bool), in the shape of the hits. Source: our choice; noise
    acts along the beam only, and power falls with range squared and incidence.
    """
    sensor, shape = sweep.sensor, sweep.range_m.shape
    noise = sensor.range_noise_m * rng.standard_normal(shape)
    for material, roughness_m in _ROUGHNESS_M.items():
        rough = sweep.material == material
        # At a grazing angle an uneven surface moves the hit far along the beam.
        noise[rough] += roughness_m * rng.standard_normal(int(rough.sum())) / np.maximum(sweep.cosine[rough], 0.15)
    range_m = np.where(np.isfinite(sweep.range_m), sweep.range_m, 1e6) + noise
    range_m = np.round(range_m / sensor.range_step_m) * sensor.range_step_m
    surface = _per_item(sweep, {number: p.albedo for number, p in paint.items()}, ALBEDO) * share
    power = surface * np.maximum(sweep.cosine, 0.02) / range_m**2
    detected = 1.0 / (1.0 + np.exp(-(np.log(power) - np.log(HALF_POWER)) / POWER_SPREAD))
    kept = rng.random(shape) < detected * (1.0 - sensor.drop_rate)
    glass_loss = _per_item(sweep, {number: p.glass_loss for number, p in paint.items()}, np.zeros(len(ALBEDO)))
    kept &= (sweep.material != Material.GLASS) | (rng.random(shape) >= glass_loss)
    kept &= (range_m >= sensor.min_range_m) & (range_m <= sensor.max_range_m)
    speckle = np.exp(0.25 * rng.standard_normal(shape))
    reflectance = np.clip(surface * np.sqrt(sweep.cosine) * speckle, 0.0, 1.0)
    return range_m.astype(np.float32), np.round(reflectance, 2).astype(np.float32), kept


def _per_item(sweep: Hits, values: dict[int, float], otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Look up the value of each beam's item, or of its material if the item has no value."""
    most = max([int(sweep.item.max(initial=-1)), *values])
    own = np.full(most + 3, np.nan)
    for number, value in values.items():
        own[number + 2] = value
    image = own[sweep.item + 2]
    return np.where(np.isnan(image), otherwise[sweep.material], image)


@dataclass(frozen=True)
class Echoes:
    """Returns of one turn, or of several turns one after the other.

    Attributes:
        points, origins: (K, 3) float32 in the frame of the scene's points; origins are a view of one row if possible.
        reflectance, time_s: (K,) float32. pixel: (K, 2) int32, row and column in the sensor's range image.
    """

    points: Float32
    origins: Float32
    reflectance: Float32
    time_s: Float32
    pixel: NDArray[np.int32]

    @staticmethod
    def of(sweep: Sweep, cells: Cells, range_m: Float32, reflectance: Float32, compensated: bool) -> Echoes:
        """Convert returns of some beams of a sweep.

        Args:
            cells: row and column of each beam; range_m, reflectance: (K,).
            compensated: points belong to time 0; otherwise to the frame of the sensor at the firing time.
        """
        row, column = cells
        points = (sweep.directions[row, column] * range_m[:, None]).astype(np.float32)
        starts = _origins_of_columns(sweep, compensated)
        if starts.any():  # skipped at the origin: adding zero turns -0.0 into 0.0
            points = (points + starts[column if len(starts) > 1 else 0]).astype(np.float32)
        pixel = np.stack(cells, axis=1).astype(np.int32)
        times = sweep.sensor.firing_times_s()[column].astype(np.float32)
        return Echoes(points, _origins(starts, column), reflectance, times, pixel)

    @staticmethod
    def of_kept(
        sweep: Sweep, kept: NDArray[np.bool_], range_m: Float32, reflectance: Float32, compensated: bool
    ) -> Echoes:
        """Convert the kept returns of a sweep, row by row; arguments (rows, columns)."""
        row, column = np.nonzero(kept)
        return Echoes.of(sweep, (row, column), range_m[kept], reflectance[kept], compensated)

    @staticmethod
    def joined(parts: Sequence[Echoes]) -> Echoes:
        if len(parts) == 1:
            return parts[0]
        joined = {name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])}
        origins = joined["origins"]
        if not (origins != origins[:1]).any():
            joined["origins"] = np.broadcast_to(origins[:1].copy(), origins.shape)
        return Echoes(**joined)


def no_return_beams(sweeps: Sequence[tuple[Sweep, NDArray[np.bool_]]], compensated: bool) -> NoReturnBeams:
    """Collect the no-return beams of sweeps, row by row; each sweep comes with its kept beams (rows, columns)."""
    origins, directions, times = [], [], []
    for sweep, kept in sweeps:
        row, column = np.nonzero(~kept)
        directions.append(sweep.directions[row, column])
        origins.append(_origins(_origins_of_columns(sweep, compensated), column))
        times.append(sweep.sensor.firing_times_s()[column].astype(np.float32))
    together = origins[0] if len(origins) == 1 else np.concatenate(origins)
    return NoReturnBeams(together, np.concatenate(directions), np.concatenate(times))


def _origins_of_columns(sweep: Sweep, compensated: bool) -> NDArray[np.float64]:
    """Return beam origins (1, 3) or (columns, 3) in the frame of the points."""
    return sweep.origins_m if compensated else np.array(sweep.mount.origin_m)[None]


def _origins(starts: NDArray[np.float64], column: NDArray[np.intp]) -> Float32:
    if len(starts) == 1:
        return np.broadcast_to(starts.astype(np.float32), (len(column), 3))
    return starts[column].astype(np.float32)
