"""A vehicle's surface as points with normals, standing on the ground, and how far other points are from it."""

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
"""Points of a surface: 9 cm apart on a car. Against exact distances to triangles, means of 1.5 to 5 cm come out 0.5 to
1.5 mm higher (`tests/benchmarks/bench_naturalness.py`)."""
DISC = 2.0
"""Radius of a point's disc in radii of the area that is its own: discs overlap, so that no gap is left between them."""
_NEIGHBOURS = 12
# Low-discrepancy steps of places in a triangle (R2 sequence), so that no seed is needed.
_STEP_A, _STEP_B = 0.7548776662466927, 0.5698402909980532
_CELL_M = 0.1  # of the curve along which triangles are passed
# Numbers with two free bits before each of their own.
_SPREAD = np.array([sum(((n >> bit) & 1) << (3 * bit) for bit in range(10)) for n in range(1024)], np.int64)


@dataclass(frozen=True, eq=False)
class Surface:
    """Points of a surface, each standing for a disc of the surface.

    Attributes:
        points: (N, 3) float64 metres; x forward, y left, z up, the box's centre at x = y = 0, its lowest point at
            z = 0: a vehicle is the same wherever it stands. Neighbours in space are neighbours in order.
        normals: (N, 3) float64 unit vectors across the discs, either way.
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
        """Distance (M,) metres of points (M, 3), this frame, to the surface: to the disc of the nearest point.

        Differentiable w.r.t.: nothing.
        Source: our choice: the distance to the nearest point alone is 4 cm too large for a car of 4,096 points.
        """
        _, nearest = self._tree.query(points)
        offset = points - self.points[nearest]
        across = np.abs(np.einsum("ij,ij->i", offset, self.normals[nearest]))
        along = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - across**2, 0.0))
        return np.asarray(np.hypot(across, np.maximum(along - self.disc_m, 0.0)), np.float64)

    def nearest_points_m(self, points: Array, most_m: float) -> Array:
        """Distance (M,) metres of points (M, 3) to the nearest of the surface's points, at most `most_m`."""
        found, _ = self._tree.query(points, distance_upper_bound=most_m)
        return np.minimum(np.asarray(found, np.float64), most_m)


def surface_of_mesh(mesh: trimesh.Trimesh) -> Surface:
    """A mesh's surface: POINTS points spread evenly over its area, the same for the same mesh.

    Args: mesh: x forward, y left, z up, metres, anywhere; need not be closed.
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
    """A surface from points (N, 3) spread over it about evenly, metres; normals are of planes through neighbours.

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
    """Order (N,) along a Morton curve through cells: every n-th of it is spread evenly, too."""
    cells = np.minimum((places - places.min(axis=0)) / _CELL_M, len(_SPREAD) - 1).astype(np.int64)
    code = _SPREAD[cells[:, 0]] | _SPREAD[cells[:, 1]] << 1 | _SPREAD[cells[:, 2]] << 2
    return np.lexsort((places.sum(axis=1), code))
