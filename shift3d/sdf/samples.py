"""Samples of a mesh's signed distance, distributed as in DeepSDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.sdf.meshes import distance_to_surface, triangles

# Park et al. 2019, supplement: two Gaussian variances about the surface, in units of the unit sphere, which is the
# bounding sphere enlarged by 3 %.
NEAR_VARIANCES = (0.0025, 0.00025)
SPHERE_MARGIN = 1.03


@dataclass(frozen=True)
class SdfSamples:
    """Signed-distance samples of one shape.

    points: (N, 3) float32, sdf frame, unit sphere. distances: (N,) float32, sdf units, negative inside.
    scale_m: metres per sdf unit, so that x_sdf = (x_mesh - centre of the mesh's box) / scale_m.
    """

    points: NDArray[np.float32]
    distances: NDArray[np.float32]
    scale_m: float


def is_closed(mesh: trimesh.Trimesh) -> bool:
    """True if every edge is used equally often in both directions, so that inside and outside are defined.

    Weaker than trimesh's is_watertight, which requires exactly two triangles per edge and ignores directions. Where
    pieces touch, four triangles share an edge, and the mesh still bounds a solid.
    """
    edges = np.asarray(mesh.edges)
    if len(edges) == 0:
        return False
    _, group = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    direction = np.sign(edges[:, 1] - edges[:, 0])
    return not np.bincount(group.ravel(), weights=direction).any()


def winding_number(mesh: trimesh.Trimesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the winding number (N,) of a closed mesh at points (N, 3): 1 inside, 0 outside; approximate (libigl)."""
    import igl

    found = igl.fast_winding_number(*triangles(mesh), np.ascontiguousarray(points, np.float64))
    return np.asarray(found, np.float64)


def signed_distance(mesh: trimesh.Trimesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the exact signed distance (N,) to a closed mesh, negative inside, in the mesh's unit (libigl).

    The sign comes from pseudonormals. These are undefined for edges with more than two triangles; for such a mesh the
    sign comes from the winding number.
    """
    import igl

    if mesh.is_watertight:
        points = np.ascontiguousarray(points, np.float64)
        result = igl.signed_distance(points, *triangles(mesh), igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)
        return np.asarray(result[0], np.float64)
    distance = distance_to_surface(points, mesh)
    return np.asarray(np.where(winding_number(mesh, points) > 0.5, -distance, distance), np.float64)


def bounding_scale(mesh: trimesh.Trimesh) -> float:
    """Return the radius, in the mesh's unit, of the bounding sphere about the box's centre, enlarged by 3 %."""
    return float(np.linalg.norm(mesh.vertices - mesh.bounds.mean(axis=0), axis=1).max() * SPHERE_MARGIN)


def sample_sdf(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> SdfSamples:
    """Sample the signed distance of a closed mesh.

    Args:
        mesh: closed (see `is_closed`), normals outwards, any unit.
        count: samples: 47 % about the surface at each of the two published variances, 6 % uniform in the unit sphere.
        rng: the only source of randomness.
    Raises: InputError when the mesh is not closed: inside and outside are then undefined.
    Source: Park et al. 2019 (SHIFT3D trains its DeepSDF "as the original"); the sphere is centred on the mesh's box.
    """
    if not mesh.is_watertight and not is_closed(mesh):
        raise InputError("the mesh is not closed", where="sample_sdf", remedy="Repair it, or decode one from its scan")
    scale = bounding_scale(mesh)
    unit = trimesh.Trimesh((mesh.vertices - mesh.bounds.mean(axis=0)) / scale, mesh.faces, process=False)
    return SdfSamples(*sample_sdf_within(unit, count, rng), scale)


def sample_sdf_within(
    unit: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sample as `sample_sdf` a closed mesh that is already in the unit sphere: points (N, 3), distances (N,)."""
    near = int(0.47 * count)
    clouds = []
    for variance in NEAR_VARIANCES:
        surface, _ = trimesh.sample.sample_surface(unit, near, seed=rng)
        clouds.append(np.asarray(surface) + rng.normal(0.0, np.sqrt(variance), (near, 3)))
    rest = count - 2 * near
    direction = rng.normal(size=(rest, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    clouds.append(direction * np.cbrt(rng.uniform(size=(rest, 1))))
    points = np.concatenate(clouds).astype(np.float32)
    return points, signed_distance(unit, points.astype(np.float64)).astype(np.float32)
