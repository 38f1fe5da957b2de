"""Vehicle surface as points with normals, resting on the ground, with distances from other points."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from shift3d.errors import InputError

Array = NDArray[np.float64]
POINTS = 4096
"""Number of points of a surface: 9 cm apart on a car. Against exact distances to triangles, means of 1.5 to 5 cm are
0.5 to 1.5 mm too high (`tests/benchmarks/bench_naturalness.py`)."""
DISC = 2.0
"""Radius of a point's disc, in radii of a disc with the point's share of the area; discs overlap and leave no gap."""
_NEIGHBOURS = 12
# Low-discrepancy steps of points in a triangle (R2 sequence), so that no seed is needed.
_STEP_A, _STEP_B = 0.7548776662466927, 0.5698402909980532
_CELL_M = 0.1  # of the Morton curve that orders the triangles
# Integers with two zero bits inserted before each bit.
_SPREAD = np.array([sum(((n >> bit) & 1) << (3 * bit) for bit in range(10)) for n in range(1024)], np.int64)


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface as points, each the centre of a disc.

    Attributes:
        points: (N, 3) float64 metres; x forward, y left, z up, the box's centre at x = y = 0, its lowest point at
            z = 0, so a vehicle's place does not matter. Spatial neighbours are close in order.
        normals: (N, 3) float64 unit normals of the discs, either sign.
        disc_m: radius of the discs. size_m: length, width and height of the box.
    """

    points: Array
    normals: Array
    disc_m: float
    size_m: tuple[float, float, float]

    @functools.cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points, balanced_tree=False, compact_nodes=False)

    def distances_to(self, points: Array) -> Array:
        """Compute distances (M,) in metres from points (M, 3), same frame, to the disc of the nearest surface point.

        Differentiable w.r.t.: nothing.
        Source: our choice: the distance to the nearest point alone is 4 cm too large for a car of 4,096 points.
        """
        _, nearest = self._tree.query(points)
        offset = points - self.points[nearest]
        across = np.abs(np.einsum("ij,ij->i", offset, self.normals[nearest]))
        along = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - across**2, 0.0))
        return np.asarray(np.hypot(across, np.maximum(along - self.disc_m, 0.0)), np.float64)

    def nearest_points_m(self, points: Array, most_m: float) -> Array:
        """Compute distances (M,) in metres from points (M, 3) to the nearest surface point, at most `most_m`."""
        found, _ = self._tree.query(points, distance_upper_bound=most_m)
        return np.minimum(np.asarray(found, np.float64), most_m)


def surface_of_mesh(mesh: trimesh.Trimesh) -> Surface:
    """Sample POINTS points evenly over a mesh's area; deterministic.

    Args: mesh: x forward, y left, z up, metres, at any place; need not be closed.
    Raises: InputError for a mesh without area or with coordinates that are not finite.
    """
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
    if not len(corners) or not np.isfinite(corners).all():
        raise InputError("no triangles, or coordinates that are not finite", "surface", "Give a mesh of a vehicle")
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    corners = corners - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(crossed, axis=1)
    if not doubled.sum() > 0.0:
        raise InputError("the surface has no area", "surface", "Give a mesh of a vehicle")
    order = _along_a_curve(corners.mean(axis=1))
    reached = np.cumsum(doubled[order])
    face = order[np.searchsorted(reached, (np.arange(POINTS) + 0.5) / POINTS * reached[-1])]
    a, b = _STEP_A * np.arange(POINTS) % 1.0, _STEP_B * np.arange(POINTS) % 1.0
    beyond = a + b > 1.0
    a, b = np.where(beyond, 1.0 - a, a)[:, None], np.where(beyond, 1.0 - b, b)[:, None]
    first, second, third = corners[face].swapaxes(0, 1)
    points = first + a * (second - first) + b * (third - first)
    disc_m = DISC * float(np.sqrt(reached[-1] / 2 / POINTS / np.pi))
    return Surface(points, crossed[face] / doubled[face, None], disc_m, _size(low, high))


def surface_of_points(unchecked: NDArray[np.floating]) -> Surface:
    """Build a surface from points (N, 3), about evenly spread, metres; normals are of planes through neighbours.

    Raises: InputError for fewer than 100 points, or coordinates that are not finite.
    """
    points: Array = np.asarray(unchecked, np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 100 or not np.isfinite(points).all():
        what = f"points of shape {points.shape} are no surface, or not finite"
        raise InputError(what, "surface", "Give (N, 3) finite coordinates, 100 or more points")
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    points = points[_along_a_curve(points)]
    far, neighbours = cKDTree(points).query(points, k=_NEIGHBOURS + 1)
    around = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    normals = np.linalg.svd(around, full_matrices=False)[2][:, 2]
    own = float(np.median(far[:, -1])) / np.sqrt(_NEIGHBOURS)
    return Surface(points, normals, DISC * own, _size(low, high))


def _size(low: Array, high: Array) -> tuple[float, float, float]:
    length, width, height = (float(side) for side in high - low)
    return length, width, height


def _along_a_curve(places: Array) -> NDArray[np.int64]:
    """Return the order (N,) along a Morton curve through cells; every n-th point of the order is evenly spread too."""
    cells = np.minimum((places - places.min(axis=0)) / _CELL_M, len(_SPREAD) - 1).astype(np.int64)
    code = _SPREAD[cells[:, 0]] | _SPREAD[cells[:, 1]] << 1 | _SPREAD[cells[:, 2]] << 2
    return np.lexsort((places.sum(axis=1), code))
