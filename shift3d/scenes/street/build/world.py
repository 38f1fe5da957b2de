"""World of one street: all geometry that beams can hit, and ray casting against it."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.street.build.fleet import Fleet
from shift3d.scenes.street.build.ground import Ground
from shift3d.scenes.street.build.item import LABELLED, OWN_CAR_M, Item, items_overlapping
from shift3d.scenes.street.build.item_geometry import ITEM_GEOMETRY, Leaves
from shift3d.scenes.street.build.layout import Layout
from shift3d.scenes.street.build.pool import PoolVehicle
from shift3d.scenes.street.raycast import Float, Hit, Hits, Intersector, Sweep, hit_instance, hit_leaves
from shift3d.scenes.street.sensors import Sensor
from shift3d.scenes.street.shapes import Mesh, Part, merge
from shift3d.seeding import generator


@dataclass(frozen=True)
class PlacedVehicle:
    """Vehicle of the fleet on its four wheels: item number, and pose of the object frame in the scene."""

    number: int
    vehicle: PoolVehicle
    scene_R_object: Float  # noqa: N815
    position: Float


@dataclass(frozen=True)
class World:
    """Geometry of the street, scene frame.

    Attributes:
        mesh: the ground and all solid objects except vehicles; material and item: (F,) of the mesh's faces.
        vehicles: in the order of their item numbers. foliage: (item number, leaves).
        boxes: (7,) of every labelled item, by item number.
    """

    mesh: Intersector
    material: NDArray[np.uint8]
    item: NDArray[np.int32]
    vehicles: tuple[PlacedVehicle, ...]
    foliage: tuple[tuple[int, Leaves], ...]
    boxes: dict[int, Float]

    @staticmethod
    def of(layout: Layout, fleet: Fleet, driven_m: float = 0.0) -> World:
        """Build the world of a layout, without the items in the path of the own car during the turn."""
        solid: list[tuple[int, Part]] = []
        foliage: list[tuple[int, Leaves]] = []
        boxes: dict[int, Float] = {}
        vehicles = []
        away = _on_ego_path(layout, driven_m)
        for number, item in enumerate(layout.items):
            if away[number]:
                continue
            if item.kind == "vehicle":
                placed_vehicle = _placed_on_wheels(layout.ground, item, number, fleet.vehicle(item.variant))
                vehicles.append(placed_vehicle)
                boxes[number] = np.array([*placed_vehicle.position, *placed_vehicle.vehicle.size_m, item.heading_rad])
                continue
            parts, leaves = ITEM_GEOMETRY[item.kind](item, generator("street-thing", item.variant))
            z = _lowest_ground(layout.ground, item)
            if item.kind == "pedestrian":
                z = float(layout.ground.height(np.asarray(item.x), np.asarray(item.y)))
            solid += [(number, part.placed(item.x, item.y, z, item.heading_rad)) for part in parts]
            if item.kind in LABELLED:
                boxes[number] = _box_of_parts(parts, item, z)
            foliage += [(number, _placed_leaves(leaf, item, z)) for leaf in leaves]
        vertices, faces, material = layout.ground.mesh()
        ground = Mesh(vertices, faces, material, np.full(len(faces), -1, dtype=np.int32))
        mesh = merge(solid, ground)
        intersector = Intersector(mesh.vertices, mesh.faces)
        return World(intersector, mesh.material, mesh.item, tuple(vehicles), tuple(foliage), boxes)

    def cast(self, sweep: Sweep, rng: np.random.Generator) -> None:
        """Cast every beam of a sweep at the world and enter its first hit."""
        sweep.cast_static(self.mesh, self.material, self.item)
        for number, centre, radius_m, hit in self._hit_targets(rng):
            sweep.cast_near(centre, radius_m, hit, number)

    def _hit_targets(self, rng: np.random.Generator) -> Iterator[tuple[int, Float, float, Hit]]:
        """Yield vehicles, then leaves: item number, centre and radius of a bounding sphere, first-hit function."""
        for placed in self.vehicles:
            vehicle, pose = placed.vehicle, (placed.scene_R_object, placed.position)
            on_mesh = functools.partial(hit_instance, vehicle.intersector, *pose, vehicle.glass_band_m)
            yield placed.number, placed.position, vehicle.radius_m, on_mesh
        for number, leaf in self.foliage:
            in_leaves = functools.partial(hit_leaves, leaf.centre, leaf.radii, leaf.free_path_m, rng)
            yield number, leaf.centre, float(leaf.radii.max()), in_leaves

    def hits_from(
        self, sensor: Sensor, starts: Float, directions: Float, from_m: Float, rng: np.random.Generator
    ) -> Hits:
        """Compute first hits of single beams beyond a range.

        Args:
            starts, directions: (N, 3) float64, scene frame. from_m: (N,) range at which the search starts.

        Returns: Hits of shape (N,), ranges from the starts.
        """
        begins = starts + from_m[:, None] * directions
        range_m, face, cosine = self.mesh.first_hit(begins.astype(np.float32), directions.astype(np.float32))
        hits = Hits.none(sensor, len(starts))
        hits.enter(np.arange(len(starts)), (range_m, self.material[face], cosine), self.item[face])
        for number, centre, radius_m, hit in self._hit_targets(rng):
            near = _near(begins, directions, centre, radius_m)
            if len(near):
                hits.enter(near, hit(begins[near], directions[near]), number)
        hits.range_m = (hits.range_m + from_m).astype(np.float32)
        return hits


def _near(starts: Float, directions: Float, centre: Float, radius_m: float) -> NDArray[np.intp]:
    """Find the rays that pass a sphere ahead of their start."""
    offset = centre - starts
    along = np.einsum("ij,ij->i", offset, directions)
    apart = np.einsum("ij,ij->i", offset, offset) - np.maximum(along, 0.0) ** 2
    return np.flatnonzero(apart <= radius_m**2)


def _on_ego_path(layout: Layout, driven_m: float) -> NDArray[np.bool_]:
    """Mark the items (items,) on the floor that the own car covers while it drives driven_m ahead."""
    if not driven_m:
        return np.zeros(len(layout.items), dtype=np.bool_)
    x, y, length_m, width_m = OWN_CAR_M
    return items_overlapping(layout.items, x + (length_m + driven_m) / 2, y, driven_m, width_m)


def _placed_on_wheels(ground: Ground, item: Item, number: int, vehicle: PoolVehicle) -> PlacedVehicle:
    length, width, height = vehicle.size_m
    cos, sin = np.cos(item.heading_rad), np.sin(item.heading_rad)
    along = np.array([0.3, 0.3, -0.3, -0.3]) * length
    across = np.array([0.45, -0.45, -0.45, 0.45]) * width
    z = ground.height(*item.to_scene(along, across))
    rise = (z[0] + z[1] - z[2] - z[3]) / (2 * 0.6 * length)
    roll = (z[0] + z[3] - z[1] - z[2]) / (2 * 0.9 * width)
    forward = np.array([cos, sin, rise]) / np.sqrt(1 + rise**2)
    left = np.array([-sin, cos, roll])
    left -= (left @ forward) * forward
    left /= np.linalg.norm(left)
    scene_R_object = np.stack((forward, left, np.cross(forward, left)), axis=1)
    return PlacedVehicle(number, vehicle, scene_R_object, np.array([item.x, item.y, float(z.mean()) + height / 2]))


def _box_of_parts(parts: list[Part], item: Item, z: float) -> NDArray[np.float64]:
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = (low + high) / 2
    return np.array([*item.to_scene(middle[0], middle[1]), z + middle[2], *(high - low), item.heading_rad])


def _placed_leaves(leaf: Leaves, item: Item, z: float) -> Leaves:
    cos, sin = np.cos(item.heading_rad), np.sin(item.heading_rad)
    x, y, up = leaf.centre
    centre = np.array([*item.to_scene(x, y), z + up])
    # The ellipsoid keeps its extent along the scene's axes but not its rotation, which makes no visible difference.
    along = np.hypot(leaf.radii[0] * cos, leaf.radii[1] * sin)
    across = np.hypot(leaf.radii[0] * sin, leaf.radii[1] * cos)
    return Leaves(centre, np.array([along, across, leaf.radii[2]]), leaf.free_path_m)


def _lowest_ground(ground: Ground, item: Item) -> float:
    """Compute the lowest ground under an item's corners and centre, so that nothing floats."""
    along = np.array([0.5, 0.5, -0.5, -0.5, 0.0]) * item.size_m[0]
    across = np.array([0.5, -0.5, 0.5, -0.5, 0.0]) * item.size_m[1]
    return float(ground.height(*item.to_scene(along, across)).min())
