"""How far two surfaces are apart."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray


def distance_to_surface(points: NDArray[np.float64], mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """Distance of points (N, 3) to the nearest point of a mesh's triangles, (N,), in the mesh's unit."""
    import igl

    squared = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(mesh.vertices, np.float64),
        np.ascontiguousarray(mesh.faces, np.int64),
    )[0]
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)), np.float64)


def symmetric_chamfer(a: trimesh.Trimesh, b: trimesh.Trimesh, rng: np.random.Generator, count: int = 20_000) -> float:
    """Symmetric Chamfer distance: the mean of the two directed mean distances, in the meshes' unit.

    (mean over p on a of d(p, b) + mean over q on b of d(q, a)) / 2, with p and q `count` points uniform over the area
    and d the unsquared distance to the nearest point of the other SURFACE, not of a sample of it: two samples of one
    surface would otherwise be some centimetres apart.
    Source: our choice: DeepSDF reports squared point-to-point distances in its unit sphere, no lengths in metres.
    """
    on_a, _ = trimesh.sample.sample_surface(a, count, seed=rng)
    on_b, _ = trimesh.sample.sample_surface(b, count, seed=rng)
    there = distance_to_surface(np.asarray(on_a), b).mean()
    return float((there + distance_to_surface(np.asarray(on_b), a).mean()) / 2.0)
