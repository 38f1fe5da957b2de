"""CSG of parts with a vehicle's field: distances to simple solids, evaluated in a window of the grid.

Frame as in `solid`: x forward from the middle of the vehicle without parts, y left, z up from the ground, metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.family.solid import Grid, smooth_max, smooth_min

Array = NDArray[np.float32]
Point = tuple[float, float, float]
Bounds = tuple[Point, Point]  # low and high corner of a box
Distance = Callable[[Array, Array, Array], Array]
"""Signed distance at x (A, 1, 1), y (1, B, 1), z (1, 1, C): (A, B, C), negative inside."""
_THINNEST = 0.75
"""Radius, in grid steps, of the thinnest rod that no grid misses: slightly over half the diagonal of a cell's face."""


def drawable_radius_m(grid: Grid, radius_m: float) -> float:
    """Return `radius_m`, but at least the radius of the thinnest rod that the grid resolves."""
    return max(radius_m, _THINNEST * grid.step_m)


def _window(grid: Grid, bounds: Bounds, margin_m: float) -> tuple[slice, slice, slice]:
    slices = []
    for axis, low, high in zip((grid.x, grid.y, grid.z), *bounds, strict=True):
        first = int(np.searchsorted(axis, low - margin_m))
        slices.append(slice(max(first - 1, 0), int(np.searchsorted(axis, high + margin_m)) + 1))
    return slices[0], slices[1], slices[2]


def _apply(
    grid: Grid, field: Array, bounds: Bounds, part: Distance, blend_m: float, join: Callable[[Array, Array], Array]
) -> None:
    i, j, k = _window(grid, bounds, 3.0 * grid.step_m + blend_m)
    if min(len(grid.x[i]), len(grid.y[j]), len(grid.z[k])) == 0:
        return
    field[i, j, k] = join(field[i, j, k], part(grid.x[i, None, None], grid.y[None, j, None], grid.z[None, None, k]))


def add(grid: Grid, field: Array, bounds: Bounds, part: Distance, blend_m: float = 0.0) -> None:
    """Unite a part with the field, in place. bounds: of the part. blend_m: radius over which the crease is filled."""
    _apply(grid, field, bounds, part, blend_m, lambda a, b: smooth_min(a, b, blend_m) if blend_m else np.minimum(a, b))


def cut(grid: Grid, field: Array, bounds: Bounds, part: Distance, blend_m: float = 0.0) -> None:
    """Subtract a part from the field, in place. blend_m: radius over which the hole's edge is rounded."""

    def without(a: Array, b: Array) -> Array:
        return smooth_max(a, -b, blend_m) if blend_m else np.maximum(a, -b)

    _apply(grid, field, bounds, part, blend_m, without)


def block(low: Point, high: Point, round_m: float = 0.0, pitch_rad: float = 0.0) -> Distance:
    """Build a box with rounded edges, rotated about y through its centre; a positive pitch lifts the front end."""
    centre = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    half = [max((b - a) / 2 - round_m, 1e-3) for a, b in zip(low, high, strict=True)]
    cos, sin = np.float32(np.cos(pitch_rad)), np.float32(np.sin(pitch_rad))

    def distance(x: Array, y: Array, z: Array) -> Array:
        x, y, z = x - np.float32(centre[0]), y - np.float32(centre[1]), z - np.float32(centre[2])
        if pitch_rad:
            x, z = cos * x + sin * z, cos * z - sin * x
        q = [np.abs(v) - np.float32(h) for v, h in zip((x, y, z), half, strict=True)]
        outside = np.sqrt(sum(np.maximum(v, np.float32(0.0)) ** 2 for v in q))
        inside = np.minimum(np.maximum(np.maximum(q[0], q[1]), q[2]), np.float32(0.0))
        return np.asarray(outside + inside - np.float32(round_m), np.float32)

    return distance


def rod(a: Point, b: Point, radius_m: float) -> Distance:
    """Build a round bar from a to b with round ends."""
    edge = [q - p for p, q in zip(a, b, strict=True)]
    length = sum(e * e for e in edge)

    def distance(x: Array, y: Array, z: Array) -> Array:
        offset = [v - np.float32(p) for v, p in zip((x, y, z), a, strict=True)]
        along = sum(np.float32(e / length) * v for e, v in zip(edge, offset, strict=True))
        along = np.clip(along, 0.0, 1.0)
        squares = sum((v - np.float32(e) * along) ** 2 for e, v in zip(edge, offset, strict=True))
        return np.asarray(np.sqrt(squares) - np.float32(radius_m), np.float32)

    return distance


def ring(centre: Point, radius_m: float, tube_m: float) -> Distance:
    """Build a torus with axis x, e.g. the wheel of a bicycle carried across the tail."""

    def distance(x: Array, y: Array, z: Array) -> Array:
        around = np.hypot(y - np.float32(centre[1]), z - np.float32(centre[2])) - np.float32(radius_m)
        return np.asarray(np.hypot(around, x - np.float32(centre[0])) - np.float32(tube_m), np.float32)

    return distance


def disc(centre: Point, radius_m: float, half_width_m: float, round_m: float, axis: int) -> Distance:
    """Build a cylinder along x (axis 0) or y (axis 1) with rounded rims."""

    def distance(x: Array, y: Array, z: Array) -> Array:
        offset = [v - np.float32(c) for v, c in zip((x, y, z), centre, strict=True)]
        across = np.hypot(offset[1 - axis], offset[2]) - np.float32(radius_m)
        slab = np.abs(offset[axis]) - np.float32(half_width_m)
        return smooth_max(across, slab, round_m)

    return distance


def ball(centre: Point, radius_m: float) -> Distance:
    """Build a sphere."""

    def distance(x: Array, y: Array, z: Array) -> Array:
        squares = sum((v - np.float32(c)) ** 2 for v, c in zip((x, y, z), centre, strict=True))
        return np.asarray(np.sqrt(squares) - np.float32(radius_m), np.float32)

    return distance


def wedge(corners: list[tuple[float, float]], y_from: float, y_to: float, round_m: float) -> Distance:
    """Extrude a convex polygon of (x, z) corners along y; corners counter-clockwise as seen with x to the right."""
    shifted = [*corners[1:], corners[0]]

    def distance(x: Array, y: Array, z: Array) -> Array:
        planes = []
        for (ax, az), (bx, bz) in zip(corners, shifted, strict=True):
            length = float(np.hypot(bx - ax, bz - az))
            normal = np.float32((bz - az) / length), np.float32(-(bx - ax) / length)
            planes.append((x - np.float32(ax)) * normal[0] + (z - np.float32(az)) * normal[1])
        slab = np.maximum(np.float32(y_from) - y, y - np.float32(y_to))
        return smooth_max(np.maximum.reduce(planes), slab, round_m)

    return distance


def pair(part: Distance) -> Distance:
    """Unite a part at y > 0 with its mirror image in y = 0."""
    return lambda x, y, z: part(x, np.abs(y), z)
