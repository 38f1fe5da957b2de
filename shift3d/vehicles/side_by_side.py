"""A picture of a mesh beside what a decoder makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.store.atomic import write_atomic
from shift3d.vehicles.picture import shaded

AZIMUTHS_RAD = (np.pi / 2 - 1e-3, 0.6)
MESH_RGB = (0.62, 0.62, 0.60)


def side_by_side(mesh: trimesh.Trimesh, decoded: trimesh.Trimesh, width_px: int = 240) -> NDArray[np.uint8]:
    """Side view and view from the front left of the mesh (grey) and, to the right, of the decoded surface (blue).

    Args: both meshes in the object frame, metres, about the origin.
    Returns: (H, 4 * width_px, 3) uint8.
    """
    span_m = 1.15 * max(float(np.ptp(mesh.vertices[:, 0])), float(np.ptp(decoded.vertices[:, 0])))
    height_px = int(0.55 * width_px)
    views = [
        shaded(surface, azimuth, 0.22, width_px, height_px, span_m, **colour)
        for surface, colour in ((mesh, {"rgb": MESH_RGB}), (decoded, {}))
        for azimuth in AZIMUTHS_RAD
    ]
    return np.concatenate(views, axis=1)


def write_side_by_side(path: Path, mesh: trimesh.Trimesh, decoded: trimesh.Trimesh) -> None:
    """Write that picture as a PNG."""
    from matplotlib.image import imsave

    picture = side_by_side(mesh, decoded)
    write_atomic(path, lambda file: imsave(file, picture, format="png"))
