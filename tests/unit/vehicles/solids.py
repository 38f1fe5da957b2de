"""Closed-form solids and files of them, for the tests of meshes from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from shift3d.vehicles.mesh_files import SHAPENET_FILE


def wedge(length: float = 4.0, width: float = 1.8, height: float = 1.4) -> trimesh.Trimesh:
    """Return a solid with distinct axes: x forward, y left, z up, low at the nose, with a lamp at the left of the nose.

    Its volume is length * width * height * 3 / 4 and a cube's of 0.2.
    """
    x, y, z = length / 2, width / 2, height
    outline = np.array([[-x, 0], [x, 0], [x, z / 2], [-x, z]])
    sides = [np.column_stack([outline[:, 0], np.full(4, side), outline[:, 1]]) for side in (-y, y)]
    body = trimesh.convex.convex_hull(np.concatenate(sides))
    lamp = trimesh.creation.box((0.2, 0.2, 0.2))
    lamp.apply_translation([x + 0.2, y - 0.1, 0.2])
    return trimesh.util.concatenate([body, lamp])


def write_shapenet(root: Path, solids: dict[str, trimesh.Trimesh]) -> Path:
    """Write a folder in ShapeNet's layout and axes (nose -z, up +y), with one mesh outside the layout."""
    for name, solid in solids.items():
        file = root / "02958343" / name / SHAPENET_FILE
        file.parent.mkdir(parents=True)
        turned = solid.copy()
        x, y, z = np.asarray(solid.vertices).T
        turned.vertices = np.column_stack([-y, z, -x])
        turned.export(file)
        trimesh.creation.box().export(file.parent / "collision.obj")
    return root
