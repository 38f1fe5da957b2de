"""Closed surface around a mesh that encloses no volume: CAD with gaps, interiors and overlapping parts.

A flood fill marks the outside: every place reachable from far away at more than half a gap's width from the mesh. All
other space is solid. The boundary of the solid lies half a gap too far out and is moved back in. This is a closing in
the sense of mathematical morphology. Concavities narrower than the gap are filled too.
"""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label
from skimage.measure import marching_cubes

from shift3d.errors import InputError
from shift3d.sdf.meshes import distance_to_surface

SEAL_M = (0.05, 0.10, 0.20)
"""Gap widths to bridge. The narrowest width at which the inside does not flood is used."""
LAST_SEAL_M = 0.40  # gap width if the inside floods at every width of SEAL_M: cars with open wheel arches or windows
CELL_M = 0.025  # grid spacing: half the narrowest gap, so that no path leads through the wall between two nodes
COARSE = 4
FILLED_SHARE = 0.30
"""Minimum share of its box that a wrapped vehicle fills. Most cars fill 0.4 to 0.65, some flooded meshes 0.27."""
UNFLOODED_SHARE = 0.85  # a width has flooded if its volume is at most this share of the widest width's volume

Grid = NDArray[np.float64]


def wrapped(mesh: trimesh.Trimesh, where: str) -> tuple[trimesh.Trimesh, float, NDArray[np.float64]]:
    """Return a closed surface around a mesh in metres.

    Returns: the surface, the bridged gap width (metres), and the distances (5000,) in metres to the mesh from points
        spread over the surface.
    Raises: InputError naming `where` when the inside floods at every width.
    """
    box_m3 = float(np.prod(np.ptp(mesh.vertices, axis=0)))
    for *narrower_m, widest_m in (SEAL_M, (LAST_SEAL_M,)):
        away, low = _grid(mesh, widest_m)
        surface, best_m = _closing(away, low, widest_m), widest_m
        if surface is None or surface.volume < FILLED_SHARE * box_m3:
            continue
        least_m3 = UNFLOODED_SHARE * surface.volume
        for seal_m in narrower_m:
            narrower = _closing(away, low, seal_m)
            if narrower is not None and narrower.volume > least_m3:
                surface, best_m = narrower, seal_m
                break
        points, _ = trimesh.sample.sample_surface(surface, 5000, seed=np.random.default_rng(0))
        return surface, best_m, distance_to_surface(np.asarray(points), mesh)
    what = f"the mesh encloses no solid, not even with gaps of {100 * LAST_SEAL_M:.0f} cm bridged"
    raise InputError(what, where=where, remedy="Close its holes by hand, or leave it out")


def _grid(mesh: trimesh.Trimesh, widest_m: float) -> tuple[Grid, NDArray[np.float64]]:
    """Return the distances of a grid's nodes for closings up to a gap width, and the grid's lowest corner."""
    low = np.asarray(mesh.bounds[0]) - widest_m - 2.0 * CELL_M
    counts = np.ceil((np.asarray(mesh.bounds[1]) + widest_m + 2.0 * CELL_M - low) / CELL_M)
    counts = (-(-counts // COARSE) * COARSE + 1).astype(np.int64)
    return _distances(mesh, low, tuple(counts), widest_m / 2.0 + 3.0 * CELL_M), low


def _distances(mesh: trimesh.Trimesh, low: NDArray[np.float64], counts: tuple[int, ...], reach_m: float) -> Grid:
    """Return the distance of every node to the mesh if it is below `reach_m`, else some value that is not below.

    A distance changes by at most the way between two nodes, so the coarse nodes rule out most fine nodes.
    """
    shape = tuple(int(count) for count in counts)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1)
    coarse = distance_to_surface(index[::COARSE, ::COARSE, ::COARSE].reshape(-1, 3) * CELL_M + low, mesh)
    coarse = coarse.reshape([(n - 1) // COARSE + 1 for n in shape])
    nearest = (index + COARSE // 2) // COARSE
    at_least = coarse[tuple(np.moveaxis(nearest, -1, 0))]
    at_least = at_least - np.linalg.norm(index - nearest * COARSE, axis=-1) * CELL_M
    near = at_least < reach_m
    away = np.maximum(at_least, reach_m)
    away[near] = distance_to_surface(index[near] * CELL_M + low, mesh)
    return np.asarray(away, np.float64)


def _closing(away: Grid, low: NDArray[np.float64], seal_m: float) -> trimesh.Trimesh | None:
    """Return the closing for one gap width from the nodes' distances; None if it is empty."""
    half = seal_m / 2.0
    regions, _ = label(away > half)
    outside = regions == regions[0, 0, 0]
    # Flooded nodes and nodes of the wall keep their distance, so the surface can lie between nodes. Air that the flood
    # does not reach counts as solid.
    dilated = np.where(outside | (away <= half), away - half, half - away)
    skin = _surface(dilated, low)
    if skin is None:
        return None
    depth = np.full(away.shape, half + CELL_M)
    inside = ~outside & binary_dilation(outside, iterations=int(np.ceil(half / CELL_M)) + 2)
    depth[inside] = distance_to_surface(np.argwhere(inside) * CELL_M + low, skin)
    depth[outside] = -np.maximum(away - half, 0.0)[outside]
    return _surface(half - depth, low)


def _surface(values: Grid, low: NDArray[np.float64]) -> trimesh.Trimesh | None:
    """Extract the zero surface of grid values, negative inside, with outward normals."""
    if not values.min() < 0.0 < values.max():
        return None
    vertices, faces, _, _ = marching_cubes(values, 1e-9, spacing=(CELL_M,) * 3)
    surface = trimesh.Trimesh(vertices + low, faces[:, ::-1], process=True)
    surface.update_faces(nondegenerate_faces(surface))
    if surface.volume < 0.0:
        surface.invert()
    return surface


def nondegenerate_faces(mesh: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Mask (F,) of the faces with three different vertices. Slivers pass: removing them would open slits."""
    a, b, c = np.asarray(mesh.faces).T
    return np.asarray((a != b) & (b != c) & (c != a), np.bool_)
