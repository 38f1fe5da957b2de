"""A closed surface around a mesh that encloses nothing by itself: CAD with gaps, interiors and overlapping parts.

What cannot be reached from far away without coming nearer to the mesh than half a gap's width is solid: the outside
is flooded, everything else is filled, and the surface, half a gap too far out, is brought back in. In the terms of
mathematical morphology, a closing. Concavities narrower than the gap are filled as well: that is its price.
"""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import label
from skimage.measure import marching_cubes

from shift3d.errors import InputError
from shift3d.sdf.chamfer import distance_to_surface
from shift3d.sdf.samples import signed_distance

SEAL_M = (0.05, 0.10, 0.20)
"""Widths of gaps that are bridged, tried in turn until the inside no longer floods."""
CELLS_A_SEAL = 4
FILLED_SHARE = 0.15

Grid = NDArray[np.float64]


def wrapped(mesh: trimesh.Trimesh, where: str) -> tuple[trimesh.Trimesh, float, NDArray[np.float64]]:
    """A closed surface around a mesh in metres.

    Returns: the surface, the width of gap it bridges (metres), and the distances (5000,) metres of points spread
        over it from the mesh.
    Raises: InputError naming `where` when the inside floods whatever the width.
    """
    for seal_m in SEAL_M:
        outer = _closing(mesh, seal_m)
        if outer is not None and outer.volume > FILLED_SHARE * np.prod(np.ptp(mesh.vertices, axis=0)):
            points, _ = trimesh.sample.sample_surface(outer, 5000, seed=np.random.default_rng(0))
            return outer, seal_m, distance_to_surface(np.asarray(points), mesh)
    what = f"the mesh encloses no solid, not even with gaps of {100 * max(SEAL_M):.0f} cm bridged"
    raise InputError(what, where=where, remedy="close its holes by hand, or leave it out")


def _closing(mesh: trimesh.Trimesh, seal_m: float) -> trimesh.Trimesh | None:
    """The surface for one width, None where nothing is left of it."""
    cell, half = seal_m / CELLS_A_SEAL, seal_m / 2.0
    low = np.asarray(mesh.bounds[0]) - 4.0 * half
    shape = tuple(int(n) for n in np.ceil((mesh.bounds[1] + 4.0 * half - low) / cell) + 1)
    nodes = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3) * cell + low
    away = distance_to_surface(nodes, mesh).reshape(shape)
    regions, _ = label(away > half)
    outside = regions == regions[0, 0, 0]
    # Nodes of flooded air and of the wall around it keep their distance, so that the surface lies between the nodes;
    # air that was not reached counts as solid.
    dilated = np.where(outside | (away <= half), away - half, -np.abs(away - half))
    skin = _surface(dilated, cell, low)
    if skin is None:
        return None
    near = (~outside) & (dilated > -half - 3.0 * cell)
    eroded = np.where(outside, half + dilated, -half)
    eroded[near] = signed_distance(skin, nodes.reshape(*shape, 3)[near]) + half
    return _surface(eroded, cell, low)


def _surface(values: Grid, cell: float, low: NDArray[np.float64]) -> trimesh.Trimesh | None:
    if not values.min() < 0.0 < values.max():
        return None
    vertices, faces, _, _ = marching_cubes(values, 1e-9, spacing=(cell,) * 3)
    surface = trimesh.Trimesh(vertices + low, faces[:, ::-1], process=True)
    surface.update_faces(uncollapsed(surface))
    if surface.volume < 0.0:
        surface.invert()
    return surface


def uncollapsed(mesh: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Which faces have three different vertices, (F,). Slivers that do are kept: without them there would be slits."""
    a, b, c = np.asarray(mesh.faces).T
    return np.asarray((a != b) & (b != c) & (c != a), np.bool_)
