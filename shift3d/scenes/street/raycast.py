"""First hits of a spinning LiDAR: triangle meshes with embree, foliage as a medium that beams enter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from shift3d.scenes.street.sensors import SENSORS, Sensor
from shift3d.scenes.street.shapes import Material

Float32 = NDArray[np.float32]
Float = NDArray[np.float64]


class Intersector:
    """An embree tree over one mesh, in the mesh's own frame."""

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.int32))

    def first_hit(self, origins: Float32, directions: Float32) -> tuple[Float32, NDArray[np.int32], Float32]:
        """First hits of rays.

        Args:
            origins, directions: (N, 3) float32, directions of unit length.

        Returns:
            range_m (N,), infinite where there is no hit; face (N,), -1 there; cosine (N,) of incidence.
        """
        out = self._scene.run(origins, directions, output=1)
        face: NDArray[np.int32] = out["primID"]
        normal = out["Ng"]
        length = np.linalg.norm(normal, axis=1)
        cosine = np.abs(np.einsum("ij,ij->i", normal, directions)) / np.where(length > 0, length, 1.0)
        return np.where(face >= 0, out["tfar"], np.float32(np.inf)), face, cosine.astype(np.float32)


@lru_cache(maxsize=4)
def beam_directions(sensor_name: str) -> Float32:
    """(rows, columns, 3) unit directions of a sensor's beams, top row first."""
    sensor = SENSORS[sensor_name]
    elevation = np.asarray(sensor.elevations_rad)[:, None]
    azimuth = sensor.azimuths_rad()[None]
    directions = np.stack(
        (
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) + 0.0 * azimuth,
        ),
        axis=-1,
    )
    return directions.astype(np.float32)


@dataclass
class Sweep:
    """First hits so far, one cell a beam: (rows, columns) arrays that casting fills in.

    Attributes:
        range_m: infinite where nothing was met.
        item: number of the object met, -1 for the ground, -2 for nothing.
        material: see :class:`Material`.
        cosine: of the incidence angle.
    """

    sensor: Sensor
    range_m: Float32
    item: NDArray[np.int32]
    material: NDArray[np.uint8]
    cosine: Float32

    @classmethod
    def empty(cls, sensor: Sensor) -> Sweep:
        """A sweep that has met nothing yet."""
        shape = (len(sensor.elevations_rad), sensor.columns)
        return cls(
            sensor,
            np.full(shape, np.inf, dtype=np.float32),
            np.full(shape, -2, dtype=np.int32),
            np.zeros(shape, dtype=np.uint8),
            np.ones(shape, dtype=np.float32),
        )

    def window(self, centre: Float, radius_m: float) -> tuple[slice, NDArray[np.intp]]:
        """Rows and columns of the beams that can meet a sphere (scene frame)."""
        distance, flat = float(np.linalg.norm(centre)), float(np.hypot(centre[0], centre[1]))
        if flat <= radius_m:
            return slice(0, len(self.sensor.elevations_rad)), np.arange(self.sensor.columns)
        middle, half = np.arcsin(centre[2] / distance), np.arcsin(radius_m / distance)
        elevations = np.asarray(self.sensor.elevations_rad)
        rows = np.flatnonzero(np.abs(elevations - middle) <= half)
        step = 2 * np.pi / self.sensor.columns
        column = (np.pi - np.arctan2(centre[1], centre[0])) / step - 0.5
        reach = np.arcsin(radius_m / flat) / step
        columns = np.arange(int(np.floor(column - reach)), int(np.ceil(column + reach)) + 1)
        columns = np.unique(columns % self.sensor.columns)
        return (slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 0)), columns

    def cast_static(self, mesh: Intersector, material: NDArray[np.uint8], item: NDArray[np.int32]) -> None:
        """Cast every beam at a mesh in the scene frame; material and item are per face."""
        directions = beam_directions(self.sensor.name).reshape(-1, 3)
        range_m, face, cosine = mesh.first_hit(np.zeros_like(directions), directions)
        closer = range_m < self.range_m.reshape(-1)
        self.range_m.reshape(-1)[closer] = range_m[closer]
        self.item.reshape(-1)[closer] = item[face[closer]]
        self.material.reshape(-1)[closer] = material[face[closer]]
        self.cosine.reshape(-1)[closer] = cosine[closer]

    def cast_instance(
        self,
        mesh: Intersector,
        scene_R_object: Float,
        position: Float,
        radius_m: float,
        glass_band_m: tuple[float, float],
        item: int,
    ) -> None:
        """Cast the beams near a vehicle at its mesh, in the object frame.

        Args:
            mesh: in the object frame, within radius_m of its origin.
            scene_R_object: (3, 3); position: (3,) of the object's origin in the scene.
            glass_band_m: what lies between these heights of the object frame counts as glass.
        """
        rows, columns = self.window(position, radius_m)
        directions = beam_directions(self.sensor.name)[rows][:, columns].reshape(-1, 3)
        if not len(directions):
            return
        local = np.ascontiguousarray(directions @ scene_R_object.astype(np.float32))
        origin = (-position @ scene_R_object).astype(np.float32)
        range_m, face, cosine = mesh.first_hit(np.repeat(origin[None], len(local), axis=0), local)
        height = origin[2] + np.where(face >= 0, range_m, 0.0) * local[:, 2]
        glass = (height > glass_band_m[0]) & (height < glass_band_m[1])
        material = np.where(glass, Material.GLASS, Material.VEHICLE).astype(np.uint8)
        self._merge(rows, columns, range_m, material, cosine, item)

    def cast_foliage(
        self, centre: Float, radii: Float, free_path_m: float, item: int, rng: np.random.Generator
    ) -> None:
        """Cast beams at an ellipsoid of leaves: each gets in to an exponentially distributed depth, or passes.

        Source: our choice; a beam's survival in a medium of scattered leaves falls off exponentially.
        """
        rows, columns = self.window(centre, float(radii.max()))
        directions = beam_directions(self.sensor.name)[rows][:, columns].reshape(-1, 3).astype(np.float64)
        if not len(directions):
            return
        scaled, offset = directions / radii, -centre / radii
        a = (scaled * scaled).sum(axis=1)
        b = scaled @ offset
        discriminant = b * b - a * (offset @ offset - 1.0)
        root = np.sqrt(np.maximum(discriminant, 0.0))
        enter, leave = np.maximum((-b - root) / a, 0.0), (-b + root) / a
        depth = enter + rng.exponential(free_path_m, len(directions))
        met = (discriminant > 0.0) & (depth < leave)
        range_m = np.where(met, depth, np.inf).astype(np.float32)
        material = np.full(len(range_m), Material.FOLIAGE, dtype=np.uint8)
        self._merge(rows, columns, range_m, material, np.full(len(range_m), 0.7, np.float32), item)

    def _merge(
        self,
        rows: slice,
        columns: NDArray[np.intp],
        range_m: Float32,
        material: NDArray[np.uint8],
        cosine: Float32,
        item: int,
    ) -> None:
        shape = (rows.stop - rows.start, len(columns))
        index_row, index_column = np.nonzero(range_m.reshape(shape) < self.range_m[rows][:, columns])
        flat = index_row * shape[1] + index_column
        target = (index_row + rows.start, columns[index_column])
        self.range_m[target] = range_m[flat]
        self.item[target] = item
        self.material[target] = material[flat]
        self.cosine[target] = cosine[flat]
