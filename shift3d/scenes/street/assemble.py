"""A street scene as the sensor sees it: layout, first hits, returns, labels, in one Scene record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.scenes.scene import Labels, Scene
from shift3d.scenes.street.ground import Ground
from shift3d.scenes.street.item import LABELLED, Item
from shift3d.scenes.street.layout import Layout, sample_layout
from shift3d.scenes.street.pool import POOL_SIZES, PoolVehicle, pool_vehicle
from shift3d.scenes.street.raycast import Intersector, Sweep, beam_directions
from shift3d.scenes.street.returns import Paint, finish
from shift3d.scenes.street.sensors import SENSORS
from shift3d.scenes.street.shapes import Mesh, Part, merge
from shift3d.scenes.street.things import LOOKS, Leaves
from shift3d.seeding import generator

# Windows lie between these shares of a vehicle's height; some vehicles lose most of the returns from them.
GLASS_FROM, GLASS_TO = 0.62, 0.92


def street_scene(split: str, seed: int, index: int, sensor_name: str) -> Scene:
    """One procedural scene: the same bytes for the same arguments.

    Args:
        split: "train", "val" or "test": disjoint layouts and disjoint vehicles.
        seed, index: which scene.
        sensor_name: "hdl64" or "waymo_top".

    Returns:
        A scene with first returns, reflectance, firing times and range-image indices. Labelled are vehicles,
        pedestrians and cyclists with at least one point in their box.

    Raises:
        InputError: for an unknown split or sensor.

    Source: our choice.
    """
    if split not in POOL_SIZES:
        raise InputError(f"unknown split {split!r}", "street", f"Choose from {', '.join(POOL_SIZES)}.")
    if sensor_name not in SENSORS:
        raise InputError(f"unknown sensor {sensor_name!r}", "street", f"Choose from {', '.join(SENSORS)}.")
    sensor = SENSORS[sensor_name]
    parts = ("street-scene", split, seed, index, sensor_name)
    layout = sample_layout(generator(*parts, "layout"), sensor.mount_height_m)
    rng = generator(*parts, "sensing")
    sweep, boxes = _cast(layout, split, sensor_name, rng)
    range_m, reflectance, kept = finish(sweep, _sample_paint(layout, rng), rng)
    points = (beam_directions(sensor_name)[kept] * range_m[kept][:, None]).astype(np.float32)
    index_image = np.argwhere(kept).astype(np.int32)
    return Scene(
        scene_id=f"street-{split}-{sensor_name}-{index:06d}" + (f"-seed{seed}" if seed else ""),
        dataset=f"street-{sensor_name}",
        points=points,
        origins=np.broadcast_to(np.zeros((1, 3), dtype=np.float32), points.shape),
        ground_z_m=-sensor.mount_height_m,
        labels=_labels(layout, boxes, points),
        reflectance=reflectance[kept],
        time_s=(index_image[:, 1] * (sensor.turn_s / sensor.columns)).astype(np.float32),
        range_image_index=index_image,
    )


def _cast(
    layout: Layout, split: str, sensor_name: str, rng: np.random.Generator
) -> tuple[Sweep, dict[int, NDArray[np.float64]]]:
    """First hits of every beam; the box (7,) of every labelled item, by item number."""
    sweep = Sweep.empty(SENSORS[sensor_name])
    solid: list[tuple[int, Part]] = []
    foliage: list[tuple[int, Leaves]] = []
    boxes: dict[int, NDArray[np.float64]] = {}
    for number, item in enumerate(layout.items):
        if item.kind == "vehicle":
            continue
        parts, leaves = LOOKS[item.kind](item, generator("street-thing", item.variant))
        z = _lowest_ground(layout.ground, item) if item.kind != "pedestrian" else _ground_at(layout.ground, item)
        placed = [part.placed(item.x, item.y, z, item.heading_rad) for part in parts]
        solid += [(number, part) for part in placed]
        if item.kind in LABELLED:
            boxes[number] = _box_of_parts(parts, item, z)
        foliage += [(number, _placed_leaves(leaf, item, z)) for leaf in leaves]
    vertices, faces, material = layout.ground.mesh()
    ground = Mesh(vertices, faces, material, np.full(len(faces), -1, dtype=np.int32))
    mesh = merge(solid, ground)
    sweep.cast_static(Intersector(mesh.vertices, mesh.faces), mesh.material, mesh.item)
    for number, item in enumerate(layout.items):
        if item.kind == "vehicle":
            boxes[number] = _cast_vehicle(sweep, layout.ground, item, number, pool_vehicle(split, item.variant))
    for number, leaf in foliage:
        sweep.cast_foliage(leaf.centre, leaf.radii, leaf.free_path_m, number, rng)
    return sweep, boxes


def _sample_paint(layout: Layout, rng: np.random.Generator) -> dict[int, Paint]:
    """Albedo of each vehicle's body, and how much of what meets its windows comes back."""
    paint = {}
    for number, item in enumerate(layout.items):
        if item.kind == "vehicle":
            opaque = rng.random() < 0.5
            through = 0.0 if opaque else float(rng.uniform(0.2, 0.9))
            paint[number] = Paint(albedo=float(rng.uniform(0.05, 0.7)), glass_loss=through)
    return paint


def _cast_vehicle(sweep: Sweep, ground: Ground, item: Item, number: int, vehicle: PoolVehicle) -> NDArray[np.float64]:
    """Stand a vehicle on its four wheels, cast at it, return its box (7,)."""
    length, width, height = vehicle.size_m
    cos, sin = np.cos(item.heading_rad), np.sin(item.heading_rad)
    along = np.array([0.3, 0.3, -0.3, -0.3]) * length
    across = np.array([0.45, -0.45, -0.45, 0.45]) * width
    z = ground.height(item.x + cos * along - sin * across, item.y + sin * along + cos * across)
    rise = (z[0] + z[1] - z[2] - z[3]) / (2 * 0.6 * length)
    roll = (z[0] + z[3] - z[1] - z[2]) / (2 * 0.9 * width)
    forward = np.array([cos, sin, rise]) / np.sqrt(1 + rise**2)
    left = np.array([-sin, cos, roll])
    left -= (left @ forward) * forward
    left /= np.linalg.norm(left)
    scene_R_object = np.stack((forward, left, np.cross(forward, left)), axis=1)
    position = np.array([item.x, item.y, float(z.mean()) + height / 2])
    glass_band = (GLASS_FROM * height - height / 2, GLASS_TO * height - height / 2)
    sweep.cast_instance(vehicle.intersector, scene_R_object, position, vehicle.radius_m, glass_band, number)
    return np.array([*position, length, width, height, item.heading_rad])


def _box_of_parts(parts: list[Part], item: Item, z: float) -> NDArray[np.float64]:
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = (low + high) / 2
    cos, sin = np.cos(item.heading_rad), np.sin(item.heading_rad)
    x = item.x + cos * middle[0] - sin * middle[1]
    y = item.y + sin * middle[0] + cos * middle[1]
    return np.array([x, y, z + middle[2], *(high - low), item.heading_rad])


def _placed_leaves(leaf: Leaves, item: Item, z: float) -> Leaves:
    cos, sin = np.cos(item.heading_rad), np.sin(item.heading_rad)
    x, y, up = leaf.centre
    centre = np.array([item.x + cos * x - sin * y, item.y + sin * x + cos * y, z + up])
    # The blob keeps its reach along the scene's axes but not its tilt: nobody can tell.
    along = np.hypot(leaf.radii[0] * cos, leaf.radii[1] * sin)
    across = np.hypot(leaf.radii[0] * sin, leaf.radii[1] * cos)
    return Leaves(centre, np.array([along, across, leaf.radii[2]]), leaf.free_path_m)


def _ground_at(ground: Ground, item: Item) -> float:
    return float(ground.height(np.asarray(item.x), np.asarray(item.y)))


def _lowest_ground(ground: Ground, item: Item) -> float:
    """Lowest ground under an item's corners, so that nothing floats."""
    cos, sin = np.cos(item.heading_rad), np.sin(item.heading_rad)
    along = np.array([0.5, 0.5, -0.5, -0.5, 0.0]) * item.size_m[0]
    across = np.array([0.5, -0.5, -0.5, 0.5, 0.0]) * item.size_m[1]
    return float(ground.height(item.x + cos * along - sin * across, item.y + sin * along + cos * across).min())


def _labels(layout: Layout, boxes: dict[int, NDArray[np.float64]], points: NDArray[np.float32]) -> Labels:
    numbers = sorted(boxes)
    stacked = np.stack([boxes[number] for number in numbers]) if numbers else np.zeros((0, 7))
    counts = _count_points(points, stacked)
    seen = np.flatnonzero(counts > 0)
    names = tuple(layout.items[numbers[i]].kind for i in seen)
    return Labels(stacked[seen], tuple(LABELLED[name] for name in names), counts[seen])


def _count_points(points: NDArray[np.float32], boxes: NDArray[np.float64]) -> NDArray[np.int32]:
    """Points in each box, looking only at the points near it."""
    counts = np.zeros(len(boxes), dtype=np.int32)
    for row, box in enumerate(boxes):
        reach = float(np.hypot(box[3], box[4])) / 2 + 0.1
        near = (np.abs(points[:, 0] - box[0]) < reach) & (np.abs(points[:, 1] - box[1]) < reach)
        counts[row] = int(points_in_boxes(points[near], box[None]).sum())
    return counts
