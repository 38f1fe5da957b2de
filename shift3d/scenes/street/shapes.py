"""Small closed meshes (boxes, prisms, spheres), the building blocks of the street's static objects."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int32]


class Material(IntEnum):
    """Material of a hit surface; determines reflectance, roughness and drop-out."""

    ROAD = 0
    SIDEWALK = 1
    TERRAIN = 2
    FACADE = 3
    METAL = 4
    FOLIAGE = 5
    CLOTH = 6
    WOOD = 7
    VEHICLE = 8
    GLASS = 9


ALBEDO = np.array([0.18, 0.28, 0.35, 0.45, 0.35, 0.45, 0.4, 0.35, 0.4, 0.2])


@dataclass(frozen=True)
class Part:
    """Piece of mesh: vertices (V, 3) float64, faces (F, 3) int32, one material."""

    vertices: Float
    faces: Int
    material: Material

    def placed(self, x: float, y: float, z: float, heading_rad: float) -> Part:
        """Return the part rotated by the heading about its z axis, then translated."""
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        turned = self.vertices @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Part(turned + np.array([x, y, z]), self.faces, self.material)


@lru_cache(maxsize=1)
def _unit_box() -> tuple[Float, Int]:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, dtype=np.int32)


def box(size: tuple[float, float, float], at: tuple[float, float, float], material: Material, top: float = 1.0) -> Part:
    """Build a box whose bottom centre is ``at``; its top face is scaled by ``top``."""
    corners, faces = _unit_box()
    vertices = corners * np.array(size)
    vertices[:, :2] *= np.where(corners[:, 2:] > 0.5, top, 1.0)
    return Part(vertices + np.array(at), faces, material)


def prism(
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    radii: tuple[float, float],
    material: Material,
    sides: int = 8,
) -> Part:
    """Build a (tapered) cylinder from start to end, closed at both ends."""
    a, b = np.array(start), np.array(end)
    axis = (b - a) / np.linalg.norm(b - a)
    helper = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.7 else np.array([0.0, 1.0, 0.0])
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    vertices = np.concatenate((a + radii[0] * ring, b + radii[1] * ring, a[None], b[None]))
    i = np.arange(sides)
    j = (i + 1) % sides
    sidewall = np.concatenate((np.stack((i, j, i + sides), 1), np.stack((j, j + sides, i + sides), 1)))
    caps = np.concatenate(
        (
            np.stack((j, i, np.full(sides, 2 * sides)), 1),
            np.stack((i + sides, j + sides, np.full(sides, 2 * sides + 1)), 1),
        )
    )
    return Part(vertices, np.concatenate((sidewall, caps)).astype(np.int32), material)


@lru_cache(maxsize=1)
def _unit_sphere() -> tuple[Float, Int]:
    """Build a sphere of eight meridians, five parallels and two poles."""
    polar = np.pi * np.arange(1, 6) / 6
    around = 2 * np.pi * np.arange(8) / 8
    ring = np.stack(
        (
            np.sin(polar)[:, None] * np.cos(around),
            np.sin(polar)[:, None] * np.sin(around),
            np.cos(polar)[:, None] + 0.0 * around,
        ),
        axis=-1,
    ).reshape(-1, 3)
    vertices = np.concatenate((ring, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    faces = []
    for j in range(8):
        k = (j + 1) % 8
        faces += [(40, j, k), (41, 32 + k, 32 + j)]
        for i in range(4):
            a, b = 8 * i, 8 * i + 8
            faces += [(a + j, b + j, b + k), (a + j, b + k, a + k)]
    return vertices, np.array(faces, dtype=np.int32)


def ellipsoid(radii: tuple[float, float, float], at: tuple[float, float, float], material: Material) -> Part:
    vertices, faces = _unit_sphere()
    return Part(vertices * np.array(radii) + np.array(at), faces, material)


@dataclass(frozen=True)
class Mesh:
    """Merged parts: vertices (V, 3), faces (F, 3), and each face's material and item number (F,)."""

    vertices: Float
    faces: Int
    material: NDArray[np.uint8]
    item: Int


def merge(parts: Iterable[tuple[int, Part]], base: Mesh) -> Mesh:
    """Append (item number, part) pairs to a mesh."""
    vertices, faces = [base.vertices], [base.faces]
    material, item = [base.material], [base.item]
    count = len(base.vertices)
    for number, part in parts:
        vertices.append(part.vertices)
        faces.append(part.faces + np.int32(count))
        material.append(np.full(len(part.faces), part.material, dtype=np.uint8))
        item.append(np.full(len(part.faces), number, dtype=np.int32))
        count += len(part.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces), np.concatenate(material), np.concatenate(item))
