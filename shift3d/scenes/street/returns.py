"""From first hits to returns: noise along the beam, rounding, drop-out, reflectance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.sensor import SensorModel
from shift3d.scenes.street.raycast import Hits
from shift3d.scenes.street.sensors import Sensor
from shift3d.scenes.street.shapes import ALBEDO, Material

# Received power, albedo * cosine / range^2 in 1/m^2, at which half of the returns are lost; and the width of
# the transition in factors of e. The ground then fades out between 45 and 65 m, as it does in KITTI frames.
HALF_POWER = 2.2e-6
POWER_SPREAD = 0.45
LIMIT_RANGE_M = float(np.sqrt(0.9 / HALF_POWER))
"""Where a surface of albedo 0.9 met head on sends back just HALF_POWER, as `SensorModel` states the law."""
_ROUGHNESS_M = {Material.TERRAIN: 0.02, Material.FOLIAGE: 0.05, Material.CLOTH: 0.01}


@dataclass(frozen=True)
class Paint:
    """Of one vehicle: albedo of its body, and the share of beams that its windows do not send back."""

    albedo: float
    glass_loss: float


def sensor_model(sensor: Sensor) -> SensorModel:
    """The sensor as `finish` acts it. Beside it, rough surfaces scatter ranges and drop_rate loses returns anywhere."""
    return SensorModel(
        range_noise_m=sensor.range_noise_m,
        divergence_rad=sensor.divergence_rad,
        limit_range_m=LIMIT_RANGE_M,
        power_spread=POWER_SPREAD,
    )


def finish(
    sweep: Hits, paint: dict[int, Paint], rng: np.random.Generator, share: NDArray[np.float64] | float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Ranges as a sensor reports them.

    Args:
        sweep: first hits of every beam.
        paint: of vehicles, by item number; everything else has its material's albedo.
        share: of each beam's light that gets there and back; the rest met something in front.

    Returns: range_m, reflectance (both float32) and kept (bool), in the shape of the hits.

    Source: our choice; noise acts along the beam only, and power falls with range squared and incidence.
    """
    sensor, shape = sweep.sensor, sweep.range_m.shape
    noise = sensor.range_noise_m * rng.standard_normal(shape)
    for material, roughness_m in _ROUGHNESS_M.items():
        rough = sweep.material == material
        # An uneven surface met at a grazing angle moves the hit far along the beam.
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
    """For each beam the value of the item it met, or that of the material where the item has none."""
    most = max([int(sweep.item.max(initial=-1)), *values])
    own = np.full(most + 3, np.nan)
    for number, value in values.items():
        own[number + 2] = value
    image = own[sweep.item + 2]
    return np.where(np.isnan(image), otherwise[sweep.material], image)
