"""First hits of a spinning LiDAR: triangle meshes by embree, foliage as a medium that beams enter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from shift3d.scenes.street.sensors import AT_ORIGIN, BY_NAME, Mount, Sensor
from shift3d.scenes.street.shapes import Material

Float32 = NDArray[np.float32]
Float = NDArray[np.float64]
FirstHits = tuple[Float32, NDArray[np.uint8], Float32]
"""First hits of N rays: range_m (N,), infinite without a hit, material and cosine (N,)."""
Hit = Callable[[Float, NDArray[np.floating]], FirstHits]
"""Function that computes first hits on one object: starts (3,) or (N, 3), unit directions (N, 3), scene frame."""
_LEAVES_COSINE = 0.7  # leaves face every way


class Intersector:
    """Embree tree over one mesh, in the mesh's frame. vertices: (V, 3) float32. faces: (F, 3) int32."""

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self.vertices, self.faces = np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.int32)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self.vertices, self.faces)

    def first_hit(self, origins: Float32, directions: Float32) -> tuple[Float32, NDArray[np.int32], Float32]:
        """Compute first hits of rays.

        Args:
            origins, directions: (N, 3) float32, directions of unit length.

        Returns: range_m (N,), infinite without a hit; face (N,), -1 without a hit; cosine (N,) of incidence.
        """
        out = self._scene.run(origins, directions, output=1)
        face: NDArray[np.int32] = out["primID"]
        normal = out["Ng"]
        length = np.linalg.norm(normal, axis=1)
        cosine = np.abs(np.einsum("ij,ij->i", normal, directions)) / np.where(length > 0, length, 1.0)
        return np.where(face >= 0, out["tfar"], np.float32(np.inf)), face, cosine.astype(np.float32)


@lru_cache(maxsize=4)
def beam_directions(sensor_name: str) -> Float32:
    """Compute unit directions (rows, columns, 3) of a sensor's beams in its own frame, top row first."""
    sensor = BY_NAME[sensor_name]
    elevation = np.asarray(sensor.elevations_rad)[:, None]
    azimuth = sensor.azimuths_rad()[None]
    directions = np.stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth),
        axis=-1,
    )
    return directions.astype(np.float32)


@dataclass
class Hits:
    """First hits of beams: arrays of one shape.

    Attributes:
        range_m: infinite without a hit.
        item: number of the object, -1 for the ground, -2 without a hit.
        material: see :class:`Material`.
        cosine: of the incidence angle.
    """

    sensor: Sensor
    range_m: Float32
    item: NDArray[np.int32]
    material: NDArray[np.uint8]
    cosine: Float32

    @staticmethod
    def none(sensor: Sensor, count: int) -> Hits:
        """Return empty hits of `count` beams."""
        return Hits(sensor, *_nothing((count,)))

    def enter(self, beams: NDArray[np.intp], found: FirstHits, item: int | NDArray[np.int32]) -> None:
        """Enter the hits of beams, indices (K,) of the flattened arrays, that are nearer than the present hits.

        item: one for all beams, or (K,).
        """
        range_m, material, cosine = found
        nearer = range_m < self.range_m.reshape(-1)[beams]
        target = beams[nearer]
        self.range_m.reshape(-1)[target] = range_m[nearer]
        self.material.reshape(-1)[target] = material[nearer]
        self.cosine.reshape(-1)[target] = cosine[nearer]
        self.item.reshape(-1)[target] = item if isinstance(item, int) else item[nearer]


def _nothing(shape: tuple[int, ...]) -> tuple[Float32, NDArray[np.int32], NDArray[np.uint8], Float32]:
    """Return arrays of beams without a hit: range, item, material, cosine."""
    ranges, items = np.full(shape, np.inf, dtype=np.float32), np.full(shape, -2, dtype=np.int32)
    return ranges, items, np.zeros(shape, dtype=np.uint8), np.ones(shape, dtype=np.float32)


@dataclass
class Sweep(Hits):
    """First hits of one turn, one cell a beam: (rows, columns) arrays that casting fills in.

    Attributes:
        mount: position and motion of the sensor; the world is static.
        directions: (rows, columns, 3) float32 unit vectors, scene frame.
        origins_m: (1, 3) float64 if all beams share one origin, else (columns, 3), the origin of each column.
    """

    mount: Mount
    directions: Float32
    origins_m: Float

    @classmethod
    def empty(cls, sensor: Sensor, mount: Mount = AT_ORIGIN) -> Sweep:
        """Return a sweep without hits."""
        shape = (len(sensor.elevations_rad), sensor.columns)
        directions = beam_directions(sensor.name)
        if mount.heading_rad:
            cos, sin = np.cos(mount.heading_rad), np.sin(mount.heading_rad)
            own_R_scene = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
            directions = (directions @ own_R_scene).astype(np.float32)
        origins = np.array(mount.origin_m)[None]
        if mount.speed_m_s:
            origins = origins + mount.speed_m_s * sensor.firing_times_s()[:, None] * np.array([1.0, 0.0, 0.0])
        return cls(sensor, *_nothing(shape), mount, directions, origins)

    def window(self, centre: Float, radius_m: float) -> tuple[slice, NDArray[np.intp]]:
        """Find rows and columns of the beams that can meet a sphere (scene frame)."""
        # Relative to the middle of the sensor's path, a sphere grown by half the path covers all origins.
        first, last = self.origins_m[0], self.origins_m[-1]
        centre, radius_m = centre - (first + last) / 2, radius_m + float(np.linalg.norm(last - first)) / 2
        distance, flat = float(np.linalg.norm(centre)), float(np.hypot(centre[0], centre[1]))
        if flat <= radius_m:
            return slice(0, len(self.sensor.elevations_rad)), np.arange(self.sensor.columns)
        middle, half = np.arcsin(centre[2] / distance), np.arcsin(radius_m / distance)
        elevations = np.asarray(self.sensor.elevations_rad)
        rows = np.flatnonzero(np.abs(elevations - middle) <= half)
        azimuth = float(np.arctan2(centre[1], centre[0])) - self.mount.heading_rad
        columns = self._columns(azimuth, float(np.arcsin(radius_m / flat)))
        return (slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 0)), columns

    def _columns(self, azimuth_rad: float, reach_rad: float) -> NDArray[np.intp]:
        """Find the columns within reach of an azimuth in the sensor's frame, and one more on each side."""
        step = self.sensor.view_rad / self.sensor.columns
        if self.sensor.view_rad < 2.0 * np.pi:
            off = np.mod(self.sensor.azimuths_rad() - azimuth_rad + np.pi, 2.0 * np.pi) - np.pi
            return np.flatnonzero(np.abs(off) <= reach_rad + step)
        column, reach = (np.pi - azimuth_rad) / step - 0.5, reach_rad / step
        columns = np.arange(int(np.floor(column - reach)), int(np.ceil(column + reach)) + 1)
        return np.unique(columns % self.sensor.columns)

    def starts(self, rows: int, columns: NDArray[np.intp]) -> Float:
        """Return the beam origins of some rows and columns: (3,) if they share one, else (rows * columns, 3)."""
        if len(self.origins_m) == 1:
            only: Float = self.origins_m[0]
            return only
        return np.broadcast_to(self.origins_m[columns], (rows, len(columns), 3)).reshape(-1, 3)

    def cast_static(self, mesh: Intersector, material: NDArray[np.uint8], item: NDArray[np.int32]) -> None:
        """Cast every beam at a mesh in the scene frame; material and item are per face."""
        directions = self.directions.reshape(-1, 3)
        starts = self.starts(len(self.directions), np.arange(self.sensor.columns)).astype(np.float32)
        range_m, face, cosine = mesh.first_hit(_each(starts, directions), directions)
        self.enter(np.arange(len(directions)), (range_m, material[face], cosine), item[face])

    def cast_near(self, centre: Float, radius_m: float, hit: Hit, item: int) -> None:
        """Cast the beams that can meet a sphere (scene frame) at the object in the sphere."""
        rows, columns = self.window(centre, radius_m)
        directions = self.directions[rows][:, columns].reshape(-1, 3)
        if len(directions):
            beams = (np.arange(rows.start, rows.stop)[:, None] * self.sensor.columns + columns).reshape(-1)
            self.enter(beams, hit(self.starts(rows.stop - rows.start, columns), directions), item)


def hit_instance(
    mesh: Intersector,
    scene_R_object: Float,
    position: Float,
    glass_band_m: tuple[float, float],
    starts: Float,
    directions: NDArray[np.floating],
) -> FirstHits:
    """Compute first hits of rays on a mesh given in its object frame.

    Args:
        scene_R_object: (3, 3); position: (3,) of the object's origin in the scene.
        glass_band_m: hits between these heights of the object frame count as glass.
        starts: (3,) or (N, 3), scene frame; directions: (N, 3).
    """
    directions = directions.astype(np.float32, copy=False)
    local = np.ascontiguousarray(directions @ scene_R_object.astype(np.float32))
    origin = ((starts - position) @ scene_R_object).astype(np.float32)
    range_m, face, cosine = mesh.first_hit(_each(origin, local), local)
    height = origin[..., 2] + np.where(face >= 0, range_m, 0.0) * local[:, 2]
    glass = (height > glass_band_m[0]) & (height < glass_band_m[1])
    return range_m, np.where(glass, Material.GLASS, Material.VEHICLE).astype(np.uint8), cosine


def hit_leaves(
    centre: Float,
    radii: Float,
    free_path_m: float,
    rng: np.random.Generator,
    starts: Float,
    directions: NDArray[np.floating],
) -> FirstHits:
    """Compute first hits of rays on an ellipsoid of leaves. Depths are exponentially distributed; deep rays pass.

    Args:
        centre, radii: (3,). free_path_m: mean depth. starts: (3,) or (N, 3), scene frame; directions: (N, 3).

    Source: our choice; a beam's survival in a medium of scattered leaves falls off exponentially.
    """
    met, enter, leave = _through_ellipsoid(starts, directions.astype(np.float64, copy=False), centre, radii)
    depth = np.maximum(enter, 0.0) + rng.exponential(free_path_m, len(directions))
    range_m = np.where(met & (depth < leave), depth, np.inf).astype(np.float32)
    material = np.full(len(range_m), Material.FOLIAGE, dtype=np.uint8)
    return range_m, material, np.full(len(range_m), _LEAVES_COSINE, np.float32)


def _through_ellipsoid(
    starts: Float, directions: Float, centre: Float, radii: Float
) -> tuple[NDArray[np.bool_], Float, Float]:
    """Compute the ranges at which rays enter and leave an ellipsoid.

    Args:
        starts: (3,) or (N, 3), scene frame; directions: (N, 3) float64 unit vectors.

    Returns: met (N,) bool, the ray's line meets the ellipsoid; enter and leave (N,), negative behind the start.
    """
    scaled, offset = directions / radii, (starts - centre) / radii
    a = (scaled * scaled).sum(axis=1)
    if offset.ndim == 1:
        b, c = scaled @ offset, offset @ offset - 1.0
    else:
        b, c = (scaled * offset).sum(axis=1), (offset * offset).sum(axis=1) - 1.0
    discriminant = b * b - a * c
    root = np.sqrt(np.maximum(discriminant, 0.0))
    return discriminant > 0.0, (-b - root) / a, (-b + root) / a


def _each(start: Float32, directions: Float32) -> Float32:
    """Repeat one start for N rays, or return N starts: (N, 3)."""
    return start if start.ndim == 2 else np.repeat(start[None], len(directions), axis=0)
