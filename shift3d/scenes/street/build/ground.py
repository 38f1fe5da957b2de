"""Ground: road with crown and curb, sidewalks, a side road, a car park, terrain, all on gentle waves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.street.shapes import Material

Float = NDArray[np.float64]

CURB_RUN_M = 0.03  # a curb is a slope this wide, so that the ground stays one height field
EXTENT_M = 130.0


@dataclass(frozen=True)
class Wave:
    """One plane wave of the terrain: amplitude, wave vector (rad/m) and phase."""

    amplitude_m: float
    kx: float
    ky: float
    phase: float


@dataclass(frozen=True)
class Ground:
    """Height field around the sensor.

    Road coordinates (u, v): u along the road, v to its left, v = 0 on its axis; the sensor is at (0, ego_v_m). Scene
    coordinates (x, y): sensor at the origin, x forward; the road has the heading road_heading_rad.

    Attributes:
        half_width_m: of the road with its parking lanes.
        sidewalk_m: width of each sidewalk.
        curb_m: height of the sidewalks above the road.
        crossing: (u, half width) of a side road at right angles, or None.
        lot: (u0, u1, v0, v1) of a paved car park, or None.
        crown: slope of the road from axis to edge, metres a metre.
        banks: slope of the terrain beyond the left and right sidewalk, metres a metre.
        waves: undulation.
        mount_height_m: height of the sensor; the ground under the sensor is at minus this height.
    """

    road_heading_rad: float
    ego_v_m: float
    half_width_m: float
    sidewalk_m: float
    curb_m: float
    crossing: tuple[float, float] | None
    lot: tuple[float, float, float, float] | None
    crown: float
    banks: tuple[float, float]
    waves: tuple[Wave, ...]
    mount_height_m: float

    def to_road(self, x: Float, y: Float) -> tuple[Float, Float]:
        cos, sin = np.cos(self.road_heading_rad), np.sin(self.road_heading_rad)
        return cos * x + sin * y, cos * y - sin * x + self.ego_v_m

    def to_scene(self, u: Float, v: Float) -> tuple[Float, Float]:
        cos, sin = np.cos(self.road_heading_rad), np.sin(self.road_heading_rad)
        v = v - self.ego_v_m
        return cos * u - sin * v, sin * u + cos * v

    def paved(self, u: Float, v: Float, grow_m: float = 0.0) -> NDArray[np.bool_]:
        """True if road, side road or car park, each grown by grow_m, covers (u, v)."""
        covered: NDArray[np.bool_] = np.abs(v) <= self.half_width_m + grow_m
        if self.crossing is not None:
            covered = covered | (np.abs(u - self.crossing[0]) <= self.crossing[1] + grow_m)
        if self.lot is not None:
            u0, u1, v0, v1 = self.lot
            covered = covered | ((u >= u0 - grow_m) & (u <= u1 + grow_m) & (v >= v0 - grow_m) & (v <= v1 + grow_m))
        return covered

    def height(self, x: Float, y: Float) -> Float:
        """Compute the ground height in the scene frame at scene (x, y), any equal shapes."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        zero = np.zeros(())
        return self._relative(x, y) - self._relative(zero, zero) - self.mount_height_m

    def _relative(self, x: Float, y: Float) -> Float:
        u, v = self.to_road(x, y)
        height = -self.crown * np.minimum(np.abs(v), self.half_width_m)
        height = height + np.where(self.paved(u, v), 0.0, self.curb_m)
        outside = np.clip(np.abs(v) - self.half_width_m - self.sidewalk_m, 0.0, 25.0)
        outside = np.where(self.paved(u, v, self.sidewalk_m), 0.0, outside)
        height = height + outside * np.where(v > 0, self.banks[0], self.banks[1])
        for wave in self.waves:
            height = height + wave.amplitude_m * np.sin(wave.kx * x + wave.ky * y + wave.phase)
        return height

    def mesh(self) -> tuple[Float, NDArray[np.int32], NDArray[np.uint8]]:
        """Triangulate the height field: vertices (V, 3) scene frame, faces (F, 3), material of each face (F,)."""
        u_edges, v_edges = self._edges()
        u, v = np.meshgrid(_grid_lines(u_edges), _grid_lines(v_edges), indexing="ij")
        x, y = self.to_scene(u, v)
        vertices = np.stack((x, y, self.height(x, y)), axis=-1).reshape(-1, 3)
        rows, columns = u.shape
        corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
        lower = np.stack((corner, corner + columns, corner + columns + 1), axis=1)
        upper = np.stack((corner, corner + columns + 1, corner + 1), axis=1)
        faces = np.concatenate((lower, upper)).astype(np.int32)
        mid_u = (u[:-1, :-1] + u[1:, 1:]).reshape(-1) / 2
        mid_v = (v[:-1, :-1] + v[1:, 1:]).reshape(-1) / 2
        material = np.full(len(mid_u), Material.TERRAIN, dtype=np.uint8)
        material[self.paved(mid_u, mid_v, self.sidewalk_m)] = Material.SIDEWALK
        material[self.paved(mid_u, mid_v)] = Material.ROAD
        return vertices, faces, np.concatenate((material, material))

    def _edges(self) -> tuple[list[float], list[float]]:
        """List the steps of the ground along u and v: lines just inside and just outside each curb."""
        u_edges: list[float] = []
        v_edges: list[float] = []
        for side in (-1.0, 1.0):
            curbs = [(v_edges, 0.0, self.half_width_m)]
            if self.crossing is not None:
                curbs.append((u_edges, self.crossing[0], self.crossing[1]))
            for edges, middle, half in curbs:
                edges += [middle + side * half, middle + side * (half + CURB_RUN_M)]
                edges.append(middle + side * (half + self.sidewalk_m))
        if self.lot is not None:
            u0, u1, v0, v1 = self.lot
            u_edges += [u0 - CURB_RUN_M, u0, u1, u1 + CURB_RUN_M]
            v_edges += [v0 - CURB_RUN_M, v0, v1, v1 + CURB_RUN_M]
        return u_edges, v_edges


def _grid_lines(edges: list[float]) -> Float:
    near = np.arange(-60.0, 60.1, 2.5)
    far = np.arange(66.0, EXTENT_M + 0.1, 8.0)
    return np.unique(np.concatenate((near, far, -far, np.asarray(edges, dtype=np.float64))))


def sample_waves(rng: np.random.Generator, strength: float) -> tuple[Wave, ...]:
    """Draw hills of 60 to 160 m and bumps of 6 to 20 m; strength 1 gives amplitudes of about 0.25 m and 2 cm."""
    waves = []
    for low, high, amplitude in ((60.0, 160.0, 0.25), (60.0, 160.0, 0.2), (6.0, 20.0, 0.015), (6.0, 20.0, 0.01)):
        k = 2 * np.pi / rng.uniform(low, high)
        angle = rng.uniform(0.0, 2 * np.pi)
        size = strength * amplitude * rng.uniform(0.2, 1.0)
        phase = rng.uniform(0.0, 2 * np.pi)
        waves.append(Wave(float(size), float(k * np.cos(angle)), float(k * np.sin(angle)), float(phase)))
    return tuple(waves)
