"""Side-view polygons and cross-section widths of a vehicle, which make its body type recognizable.

Polygons are lists of corners (s, z) in metres: s backwards from the nose, z up from the ground.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family.spec import VehicleSpec

Array = NDArray[np.float32]
Polygon = list[tuple[float, float]]


def polygon_distance(points: Array, corners: Array) -> Array:
    """Compute the signed distance of points (N, 2) to a simple polygon (M, 2), negative inside, float32."""
    following = np.roll(corners, -1, axis=0)
    best = np.full(len(points), np.inf, np.float32)
    inside = np.zeros(len(points), bool)
    for a, b in zip(corners, following, strict=True):
        edge = b - a
        offset = points - a
        along = np.clip(offset @ edge / max(float(edge @ edge), 1e-12), 0.0, 1.0)
        best = np.minimum(best, ((offset - along[:, None] * edge) ** 2).sum(axis=1))
        crosses = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
        if edge[1] != 0:
            inside ^= crosses & (points[:, 0] < a[0] + (points[:, 1] - a[1]) * edge[0] / edge[1])
    return np.asarray(np.where(inside, -np.sqrt(best), np.sqrt(best)), np.float32)


def lower_body(spec: VehicleSpec) -> Polygon:
    """Return the outline below the glass: bumpers, hood, belt and deck."""
    length, low = spec.length_m, spec.clearance_m
    hood_mid = 0.45 * spec.cowl_s_m
    hood_mid_z = spec.nose_z_m + 0.62 * (spec.cowl_z_m - spec.nose_z_m)
    bumper_z = low + 0.55 * (spec.nose_z_m - low)
    tail_bumper_z = low + 0.50 * (spec.tail_z_m - low)
    corners: Polygon = [
        (0.06, low + 0.06),
        (0.0, low + 0.18),
        (0.0, bumper_z),
        (0.06, spec.nose_z_m - 0.05),
        (0.14, spec.nose_z_m),
        (hood_mid, hood_mid_z),
        (spec.cowl_s_m, spec.cowl_z_m),
        (spec.backlight_s_m, spec.deck_z_m),
    ]
    if spec.backlight_s_m < length - 0.20:
        corners.append((length - 0.07, spec.tail_z_m))
    else:
        corners.append((length - 0.02, min(spec.tail_z_m, spec.deck_z_m)))
    corners += [(length, tail_bumper_z), (length, low + 0.22), (length - 0.10, low + 0.10), (length - 0.55, low)]
    return [*corners, (0.50, low)]


def glasshouse(spec: VehicleSpec) -> Polygon:
    """Return the outline of windshield, roof and rear window; its foot is sunk into the lower body."""
    sunk = 0.18
    crown_s = 0.45 * spec.roof_front_s_m + 0.55 * spec.roof_rear_s_m
    if spec.body_type in ("coupe", "sports_car"):
        crown_s = 0.55 * spec.roof_front_s_m + 0.45 * spec.roof_rear_s_m
    slope = (spec.roof_front_s_m - spec.cowl_s_m) / (spec.height_m - spec.cowl_z_m)
    back_slope = (spec.backlight_s_m - spec.roof_rear_s_m) / (spec.height_m - spec.roof_drop_m - spec.deck_z_m)
    return [
        (spec.cowl_s_m - slope * sunk + 0.04, spec.cowl_z_m - sunk),
        (spec.cowl_s_m + 0.04, spec.cowl_z_m),
        (spec.roof_front_s_m, spec.height_m - 0.03),
        (crown_s, spec.height_m),
        (spec.roof_rear_s_m, spec.height_m - spec.roof_drop_m),
        (spec.backlight_s_m - 0.03, spec.deck_z_m),
        (min(spec.backlight_s_m - 0.03 + back_slope * sunk, spec.length_m - 0.04), spec.deck_z_m - sunk),
    ]


def lower_half_width(spec: VehicleSpec, z: Array) -> Array:
    """Return the lower body's half width at heights z: narrow at the sills, widest at the hips."""
    half, low = spec.width_m / 2, spec.clearance_m
    hips = low + 0.55 * (spec.cowl_z_m - low)
    heights = [low, low + 0.12, hips, spec.cowl_z_m, spec.cowl_z_m + 0.3]
    widths = [half - 0.09, half - 0.035, half, half - 0.045, half - 0.12]
    return np.interp(z, heights, widths).astype(np.float32)


def glasshouse_half_width(spec: VehicleSpec, z: Array) -> Array:
    """Return the glasshouse's half width at heights z: the shoulder narrows the belt, the tumblehome the roof."""
    foot = spec.width_m / 2 - 0.045 - spec.shoulder_m
    run = spec.height_m - spec.cowl_z_m
    lean = np.clip((z - spec.cowl_z_m) / run, -0.3, 1.2)
    return np.asarray(foot - spec.tumblehome_m * (0.75 * lean + 0.25 * lean * np.abs(lean)), np.float32)


def spoiler(spec: VehicleSpec) -> Polygon:
    """Return the outline of a lip on the tail of a sports car."""
    tail = spec.length_m - 0.03
    return [
        (tail - 0.34, spec.tail_z_m - 0.10),
        (tail - 0.05, spec.tail_z_m + spec.spoiler_m),
        (tail, spec.tail_z_m + spec.spoiler_m),
        (tail, spec.tail_z_m - 0.12),
    ]


def cabin_cavity(spec: VehicleSpec) -> Polygon:
    """Return the outline of a convertible's open cabin, from behind the dashboard to the rear shelf."""
    floor = spec.clearance_m + 0.16
    return [
        (spec.cowl_s_m + 0.42, spec.height_m + 0.3),
        (spec.cowl_s_m + 0.42, spec.cowl_z_m - 0.12),
        (spec.cowl_s_m + 0.20, floor + 0.12),
        (spec.cowl_s_m + 0.30, floor),
        (spec.roof_rear_s_m - 0.12, floor),
        (spec.roof_rear_s_m, spec.deck_z_m - 0.05),
        (spec.roof_rear_s_m, spec.height_m + 0.3),
    ]


def windshield_frame(spec: VehicleSpec) -> Polygon:
    """Return the outline of the free-standing windshield of a convertible, thick enough for the grid."""
    slope = (spec.roof_front_s_m - spec.cowl_s_m) / (spec.height_m - spec.cowl_z_m)
    foot = spec.cowl_s_m + 0.02 - slope * 0.15
    return [
        (foot, spec.cowl_z_m - 0.15),
        (spec.roof_front_s_m - 0.02, spec.height_m),
        (spec.roof_front_s_m + 0.09, spec.height_m - 0.01),
        (foot + 0.17, spec.cowl_z_m - 0.15),
    ]


def seats(spec: VehicleSpec) -> list[tuple[Polygon, float, float]]:
    """Return front seats (mirrored) and rear bench of a convertible: (polygon, y from, y to), metres."""
    floor = spec.clearance_m + 0.10
    front = spec.cowl_s_m + 0.52 * (spec.roof_rear_s_m - spec.cowl_s_m)
    top = min(spec.height_m - 0.16, spec.deck_z_m + 0.22)
    seat: Polygon = [
        (front - 0.42, floor),
        (front - 0.45, floor + 0.30),
        (front + 0.05, floor + 0.26),
        (front + 0.20, top),
        (front + 0.36, top),
        (front + 0.22, floor),
    ]
    rear = spec.roof_rear_s_m
    bench: Polygon = [(rear - 0.40, floor), (rear - 0.42, floor + 0.32), (rear - 0.18, floor + 0.32)]
    bench += [(rear - 0.05, spec.deck_z_m + 0.02), (rear + 0.15, spec.deck_z_m + 0.02), (rear + 0.15, floor)]
    centre = 0.21 * spec.width_m
    parts = [(seat, centre - 0.25, centre + 0.25)]
    if rear - front > 0.85:
        parts.append((bench, -1.0, spec.width_m / 2 - 0.2))
    return parts


def bed(spec: VehicleSpec) -> Polygon:
    """Return the outline of a pickup's open load bed."""
    floor = spec.clearance_m + 0.42
    start = spec.backlight_s_m + 0.10
    end = spec.length_m - 0.13
    return [(start, spec.height_m + 0.5), (start, floor), (end, floor), (end, spec.height_m + 0.5)]
