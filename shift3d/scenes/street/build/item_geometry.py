"""Geometry of each kind of item: solid parts, and foliage that beams enter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.street.build.item import Item
from shift3d.scenes.street.shapes import Material, Part, box, ellipsoid, prism

Rng = np.random.Generator


@dataclass(frozen=True)
class Leaves:
    """Ellipsoid of leaves in the item's frame (origin on the ground), with a beam's mean free path in the leaves."""

    centre: NDArray[np.float64]
    radii: NDArray[np.float64]
    free_path_m: float


ItemGeometry = tuple[list[Part], list[Leaves]]


def _building(item: Item, rng: Rng) -> ItemGeometry:
    length, width, height = item.size_m
    parts = [box((length, width, height + 1.0), (0, 0, -1.0), Material.FACADE)]
    for _ in range(int(rng.integers(2, 7))):  # bays, porches and balconies break the flat front
        bay = (rng.uniform(0.6, 3.0), rng.uniform(0.2, 0.9), rng.uniform(0.4, height * 0.8))
        side = 1.0 if rng.random() < 0.5 else -1.0
        x = rng.uniform(-0.45, 0.45) * (length - bay[0])
        parts.append(box(bay, (x, side * width / 2, rng.uniform(0.0, height - bay[2])), Material.FACADE))
    return parts, []


def _sunk_box(material: Material, top: float, item: Item, rng: Rng) -> ItemGeometry:
    return [box((*item.size_m[:2], item.size_m[2] + 0.3), (0, 0, -0.3), material, top)], []


def _fence(item: Item, rng: Rng) -> ItemGeometry:
    length, _, height = item.size_m
    posts = np.arange(-length / 2, length / 2 + 0.1, 2.2)
    parts = [box((0.1, 0.1, height + 0.2), (float(x), 0, -0.2), Material.WOOD) for x in posts]
    rails = np.arange(0.25, height, rng.uniform(0.25, 0.5))
    return parts + [box((length, 0.04, 0.12), (0, 0, float(z)), Material.WOOD) for z in rails], []


def _pole(item: Item, rng: Rng) -> ItemGeometry:
    radius, height = item.size_m[0] / 2, item.size_m[2]
    parts = [prism((0, 0, -0.2), (0, 0, height), (radius, radius * 0.6), Material.METAL)]
    if rng.random() < 0.6:  # an arm with a lamp or a traffic light
        reach = rng.uniform(1.0, 3.0)
        parts.append(prism((0, 0, height - 0.1), (0, reach, height + 0.2), (0.05, 0.04), Material.METAL, 6))
        parts.append(box((0.3, 0.6, 0.25), (0, reach, height), Material.METAL))
    return parts, []


def _sign(item: Item, rng: Rng) -> ItemGeometry:
    height = item.size_m[2]
    face = rng.uniform(0.5, 0.9)
    post = prism((0, 0, -0.2), (0, 0, height), (0.035, 0.035), Material.METAL, 6)
    return [post, box((0.03, face, face), (0, 0, height - face), Material.METAL)], []


def _tree(item: Item, rng: Rng) -> ItemGeometry:
    height, crown = item.size_m[2], rng.uniform(1.2, 2.8)
    bare = min(rng.uniform(1.8, 3.2), height * 0.5)
    radius = item.size_m[0] / 2
    lean = rng.uniform(-0.25, 0.25, 2)
    trunk = prism((0, 0, -0.2), (lean[0], lean[1], bare + 1.0), (radius, radius * 0.7), Material.WOOD)
    leaves = []
    for _ in range(int(rng.integers(1, 4))):
        radii = crown * rng.uniform(0.6, 1.0, 3)
        radii[2] = max((height - bare) / 2 * rng.uniform(0.6, 1.0), 0.6)
        centre = np.array([*(lean + rng.uniform(-0.5, 0.5, 2) * crown), bare + radii[2] * rng.uniform(0.8, 1.2)])
        leaves.append(Leaves(centre, radii, float(rng.uniform(0.8, 3.0))))
    return [trunk], leaves


def _bush(item: Item, rng: Rng) -> ItemGeometry:
    half = np.array(item.size_m) / 2
    leaves = []
    for _ in range(int(rng.integers(1, 4))):
        radii = half * rng.uniform(0.6, 1.0, 3)
        room = half[:2] - radii[:2]
        centre = np.array([*(rng.uniform(-1, 1, 2) * room), radii[2] * 0.85])
        leaves.append(Leaves(centre, radii, float(rng.uniform(0.12, 0.5))))
    return [], leaves


def _thicket(item: Item, rng: Rng) -> ItemGeometry:
    length, width, height = item.size_m
    leaves = []
    for _ in range(int(np.clip(length / 1.6, 3, 16))):
        radii = np.array([rng.uniform(0.7, 1.8), rng.uniform(0.4, 1.0) * width / 2, rng.uniform(0.3, 1.0) * height / 2])
        x = rng.uniform(-0.5, 0.5) * (length - 2 * radii[0])
        y = rng.uniform(-0.5, 0.5) * (width - 2 * radii[1])
        centre = np.array([x, y, radii[2] * rng.uniform(0.75, 1.0)])
        leaves.append(Leaves(centre, radii, float(rng.uniform(0.15, 0.8))))
    return [], leaves


def _dumpster(item: Item, rng: Rng) -> ItemGeometry:
    length, width, height = item.size_m
    parts = [box((length, width, height * 0.85), (0, 0, 0.12), Material.METAL, rng.uniform(0.9, 1.1))]
    parts.append(box((length, width * 0.7, height * 0.12), (0, 0.1, 0.12 + height * 0.85), Material.METAL, 0.9))
    return parts, []


def _container(item: Item, rng: Rng) -> ItemGeometry:
    return [box(item.size_m, (0, 0, 0.0), Material.METAL, float(rng.uniform(0.95, 1.0)))], []


def _barrier(item: Item, rng: Rng) -> ItemGeometry:
    length, width, height = item.size_m
    return [
        box((length, width, height * 0.35), (0, 0, 0), Material.FACADE, 0.7),
        box((length, width * 0.45, height * 0.65), (0, 0, height * 0.35), Material.FACADE, 0.8),
    ], []


def _person(height: float, rng: Rng, lean_m: float = 0.0, z: float = 0.0) -> list[Part]:
    """Build legs, torso, arms and head about the origin, facing +x."""
    s = height / 1.75
    stride = rng.uniform(0.0, 0.3) * s
    top = (lean_m, 0.0, z + 1.42 * s)
    parts = [
        prism((side * stride, side * 0.1, z), (0, side * 0.09, z + 0.85 * s), (0.07, 0.09), Material.CLOTH, 6)
        for side in (-1.0, 1.0)
    ]
    parts.append(prism((0, 0, z + 0.8 * s), top, (0.17, 0.2), Material.CLOTH, 8))
    for side in (-1.0, 1.0):
        hand = (lean_m + side * rng.uniform(-0.3, 0.3), side * 0.3, z + 0.85 * s)
        parts.append(prism((lean_m, side * 0.2, z + 1.4 * s), hand, (0.06, 0.05), Material.CLOTH, 6))
    head = (lean_m * 1.15, 0.0, z + 1.62 * s)
    parts.append(ellipsoid((0.1 * s, 0.085 * s, 0.13 * s), head, Material.CLOTH))
    return parts


def _cyclist(item: Item, rng: Rng) -> ItemGeometry:
    parts = [prism((x, -0.025, 0.34), (x, 0.025, 0.34), (0.34, 0.34), Material.METAL, 12) for x in (-0.53, 0.53)]
    parts.append(box((1.0, 0.05, 0.1), (0, 0, 0.55), Material.METAL))
    parts.append(prism((0.5, 0, 0.34), (0.4, 0, 1.0), (0.03, 0.03), Material.METAL, 6))
    parts.append(prism((0.4, -0.3, 1.0), (0.4, 0.3, 1.0), (0.03, 0.03), Material.METAL, 6))
    rider = _person((item.size_m[2] - 0.3) / 0.93, rng, lean_m=float(rng.uniform(0.05, 0.3)), z=0.3)
    return parts + rider, []


ITEM_GEOMETRY: dict[str, Callable[[Item, Rng], ItemGeometry]] = {
    "building": _building,
    "wall": partial(_sunk_box, Material.FACADE, 1.0),
    "hedge": partial(_sunk_box, Material.FOLIAGE, 0.85),
    "fence": _fence,
    "pole": _pole,
    "sign": _sign,
    "tree": _tree,
    "thicket": _thicket,
    "bush": _bush,
    "dumpster": _dumpster,
    "container": _container,
    "cabinet": _container,
    "barrier": _barrier,
    "pedestrian": lambda item, rng: (_person(item.size_m[2], rng), []),
    "cyclist": _cyclist,
}
