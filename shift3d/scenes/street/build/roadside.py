"""Roadside objects: buildings, walls, trees, poles, people, and objects that a detector may take for cars."""

from __future__ import annotations

import numpy as np

from shift3d.scenes.street.build.ground import Ground
from shift3d.scenes.street.build.item import FloorPlan, Item

_VARIANTS = 1 << 20
_EDGES = ("building", "wall", "hedge", "fence", "thicket", "gap")
_EDGE_SHARES = {
    "street": (0.45, 0.08, 0.08, 0.08, 0.15, 0.16),
    "intersection": (0.45, 0.08, 0.07, 0.06, 0.12, 0.22),
    "lot": (0.3, 0.08, 0.08, 0.08, 0.16, 0.3),
    "plaza": (0.4, 0.08, 0.08, 0.05, 0.16, 0.23),
    "open": (0.06, 0.04, 0.1, 0.12, 0.3, 0.38),
}


def furnish_roadside(plan: FloorPlan, ground: Ground, kind: str, rng: np.random.Generator) -> None:
    """Add all objects except vehicles."""
    for side in (1.0, -1.0):
        _line_edge(plan, ground, kind, rng, side)
        _line_backdrop(plan, ground, rng, side)
        if kind != "plaza":
            _trees_and_poles(plan, ground, rng, side, sparse=kind == "open")
    if kind == "plaza":
        _scatter_items(plan, ground, rng, "pole", int(rng.integers(3, 10)), (10.0, 55.0))
        _scatter_items(plan, ground, rng, "tree", int(rng.integers(0, 10)), (12.0, 60.0))
    _scatter_items(plan, ground, rng, "tree", int(rng.integers(0, 8)), (15.0, 70.0), off_road=True)
    for confuser in ("dumpster", "container", "cabinet", "barrier", "bush"):
        _scatter_items(plan, ground, rng, confuser, int(rng.integers(0, 4)), (8.0, 60.0), off_road=rng.random() < 0.7)
    _scatter_items(plan, ground, rng, "bush", int(rng.integers(0, 8)), (8.0, 60.0), off_road=True)
    _scatter_items(plan, ground, rng, "pedestrian", int(rng.integers(0, 10)), (4.0, 45.0))
    _scatter_items(plan, ground, rng, "cyclist", int(rng.integers(0, 4)), (5.0, 45.0))


def _line_edge(plan: FloorPlan, ground: Ground, kind: str, rng: np.random.Generator, side: float) -> None:
    """Line one side with facades, walls, hedges, fences and gaps."""
    base = ground.half_width_m + ground.sidewalk_m
    if kind == "plaza" and ground.lot is not None:
        base = (ground.lot[3] if side > 0 else -ground.lot[2]) + 1.0
    setback = rng.uniform(0.3, 9.0)
    u = -100.0
    while u < 100.0:
        edge = str(rng.choice(_EDGES, p=_EDGE_SHARES[kind]))
        length = rng.uniform(8.0, 28.0)
        if edge == "building":
            depth, height = rng.uniform(7.0, 14.0), rng.uniform(3.5, 14.0)
            v = base + setback + rng.uniform(0.0, 1.5) + depth / 2
        else:
            depth = {"hedge": rng.uniform(0.5, 1.2), "thicket": rng.uniform(1.5, 4.5)}.get(edge, 0.25)
            height = rng.uniform(1.2, 5.0) if edge == "thicket" else rng.uniform(0.7, 2.2)
            v = base + rng.uniform(0.1, 1.0) + depth / 2
        if edge != "gap":
            turn = float(rng.normal(0.0, 0.02))
            _add(plan, ground, edge, u + length / 2, side * v, turn, (length, depth, height), rng)
        u += length + rng.uniform(0.3, 6.0)


def _line_backdrop(plan: FloorPlan, ground: Ground, rng: np.random.Generator, side: float) -> None:
    """Add a second line of houses and woods behind the first if there is room: few views end in the sky."""
    base = ground.half_width_m + ground.sidewalk_m + rng.uniform(14.0, 32.0)
    if ground.lot is not None:
        reach = ground.lot[3] if side > 0 else -ground.lot[2]
        base = max(base, reach + rng.uniform(2.0, 6.0))
    u = -110.0
    while u < 110.0:
        length = rng.uniform(10.0, 25.0)
        kind = str(rng.choice(("building", "thicket", "gap"), p=(0.4, 0.35, 0.25)))
        depth = rng.uniform(8.0, 14.0) if kind == "building" else rng.uniform(3.0, 6.0)
        height = rng.uniform(4.0, 14.0) if kind == "building" else rng.uniform(3.0, 8.0)
        if kind != "gap":
            v = side * (base + depth / 2 + rng.uniform(0.0, 6.0))
            _add(plan, ground, kind, u + length / 2, v, float(rng.normal(0.0, 0.1)), (length, depth, height), rng)
        u += length + rng.uniform(0.5, 5.0)


def _trees_and_poles(plan: FloorPlan, ground: Ground, rng: np.random.Generator, side: float, sparse: bool) -> None:
    kerb = ground.half_width_m + min(0.7, ground.sidewalk_m / 2)
    if rng.random() < 0.6:
        spacing = rng.uniform(7.0, 16.0) * (2.0 if sparse else 1.0)
        for u in np.arange(-80.0, 80.0, spacing):
            if rng.random() < 0.8:
                _tree_at(plan, ground, u + rng.normal(0.0, 0.8), side * kerb, rng)
    spacing = rng.uniform(18.0, 38.0)
    for u in np.arange(-80.0 + rng.uniform(0, 15), 80.0, spacing):
        radius = rng.uniform(0.06, 0.16)
        toward_road = -side * np.pi / 2 - np.pi / 2
        size = (2 * radius, 2 * radius, float(rng.uniform(4.0, 9.0)))
        _add(plan, ground, "pole", u, side * (kerb + 0.1), toward_road, size, rng)
    for _ in range(int(rng.integers(1, 6))):
        u, heading = rng.uniform(-60.0, 60.0), rng.choice((0.0, np.pi)) + rng.normal(0.0, 0.1)
        _add(plan, ground, "sign", u, side * (kerb + 0.2), heading, (0.1, 0.7, float(rng.uniform(2.0, 3.2))), rng)


def _tree_at(plan: FloorPlan, ground: Ground, u: float, v: float, rng: np.random.Generator) -> None:
    radius = rng.uniform(0.08, 0.28)
    size = (2 * radius, 2 * radius, float(rng.uniform(4.0, 9.0)))
    _add(plan, ground, "tree", u, v, float(rng.uniform(-np.pi, np.pi)), size, rng)


def _size(kind: str, rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw length, width and height of one scattered object."""
    low, high = {
        "pole": ((0.15, 0.15, 4.0), (0.3, 0.3, 9.0)),
        "tree": ((0.2, 0.2, 3.5), (0.5, 0.5, 9.0)),
        "dumpster": ((1.6, 1.0, 1.0), (3.6, 1.8, 1.8)),
        "container": ((3.0, 2.0, 1.6), (6.1, 2.5, 2.6)),
        "cabinet": ((0.5, 0.3, 0.9), (1.6, 0.8, 1.7)),
        "barrier": ((1.5, 0.4, 0.7), (6.0, 0.7, 1.1)),
        "bush": ((0.8, 0.8, 0.6), (4.5, 2.2, 2.0)),
        "pedestrian": ((0.5, 0.6, 1.1), (0.9, 0.75, 1.95)),
        "cyclist": ((1.7, 0.62, 1.6), (1.8, 0.66, 1.9)),
    }[kind]
    drawn = rng.uniform(low, high)
    if kind in ("pole", "tree"):
        drawn[1] = drawn[0]
    return (float(drawn[0]), float(drawn[1]), float(drawn[2]))


def _scatter_items(
    plan: FloorPlan,
    ground: Ground,
    rng: np.random.Generator,
    kind: str,
    count: int,
    distances_m: tuple[float, float],
    off_road: bool = False,
) -> None:
    """Scatter `count` objects at random places; an object that finds no room in a few tries is left out."""
    for _ in range(count):
        size, heading = _size(kind, rng), rng.uniform(-np.pi, np.pi)
        for _attempt in range(8):
            distance, bearing = rng.uniform(*distances_m), rng.uniform(-np.pi, np.pi)
            u, v = ground.to_road(np.asarray(distance * np.cos(bearing)), np.asarray(distance * np.sin(bearing)))
            if off_road and bool(ground.paved(u, v, 1.0)):
                continue
            if _add(plan, ground, kind, float(u), float(v), heading, size, rng):
                break


def _add(
    plan: FloorPlan,
    ground: Ground,
    kind: str,
    u: float,
    v: float,
    heading_road_rad: float,
    size_m: tuple[float, float, float],
    rng: np.random.Generator,
) -> bool:
    """Place one item given in road coordinates; refuses fixed objects on the side road or the car park."""
    variant = int(rng.integers(_VARIANTS))
    if kind in ("building", "wall", "hedge", "fence", "thicket", "tree", "pole", "sign"):
        ends = u + np.linspace(-0.5, 0.5, 9) * size_m[0]
        inner = np.abs(v) - size_m[1] / 2
        if kind in ("tree", "pole") and ground.lot is not None and ground.lot[0] < -39.0:
            inner = np.abs(v)  # lamps and trees are allowed in a plaza, which is paved all over
        elif bool(ground.paved(ends, np.full(9, np.sign(v) * inner)).any()):
            return False
    x, y = ground.to_scene(np.asarray(u), np.asarray(v))
    return plan.place(Item(kind, float(x), float(y), heading_road_rad + ground.road_heading_rad, size_m, variant))
