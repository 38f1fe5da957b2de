"""Crops: points in the box, beams that passed through it, and refused or flagged crops."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from known_shapes import LENGTH_M, PER_LENGTH, coordinates, scene_of, subspace, surface_points, towards

from shift3d.geometry.boxes import points_in_boxes
from shift3d.retrieval.crops import FEWEST_POINTS, FLOOR_M, KEPT_POINTS, Crop, crop_vehicles, visible_sides
from shift3d.retrieval.reconstruction import Reconstructor, vehicle_of
from shift3d.scenes.sets import StreetScenes
from shift3d.vehicles.sources import VehicleSet

BOX = np.array([14.0, 5.0, -0.9, LENGTH_M, 1.85, 1.5, 0.6])
U = 0.8 * coordinates(0)


@functools.cache
def reconstructor() -> Reconstructor:
    return Reconstructor(subspace(), PER_LENGTH, np.eye(3))


@functools.cache
def seen(count: int = 300) -> np.ndarray:
    """Return the sensor's view, from the origin, of a known shape in a box."""
    return towards(surface_points(U, count), np.array([-14.0, 5.0, 1.5]), U)


def only(points: np.ndarray, box: np.ndarray = BOX, around: np.ndarray | None = None) -> Crop:
    (crop,) = crop_vehicles(scene_of(points, box, around))
    return crop


def test_a_crop_holds_the_points_of_the_box_in_its_own_frame() -> None:
    points = seen()
    crop = only(points, around=np.random.default_rng(0).uniform(-40, 40, (500, 3)) + np.array([0.0, 0.0, 60.0]))
    above = points[points[:, 2] >= FLOOR_M - 0.75]
    assert crop.points == len(above) and not crop.refused and crop.kind == "Car"
    nearest = np.linalg.norm(crop.surface[:, None] - above[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-5 and len(crop.surface) <= KEPT_POINTS
    assert crop.range_m == pytest.approx(np.hypot(14.0, 5.0))


def test_neither_the_order_of_points_nor_the_place_in_the_scene_matters() -> None:
    points = seen()
    crop = only(points)
    shuffled = only(np.random.default_rng(1).permutation(points))
    assert np.array_equal(crop.surface, shuffled.surface) and np.array_equal(crop.free, shuffled.free)
    turn = 1.1  # the whole scene about the sensor
    there = np.array([*(np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ BOX[:2]), *BOX[2:]])
    there[6] += turn
    moved = only(points, there)
    assert crop.sides == moved.sides
    found, again = (reconstructor().reconstruct(part).fit for part in (crop, moved))
    assert np.abs(found.u - again.u).max() < 0.02


def test_places_in_the_way_of_beams_lie_before_their_returns() -> None:
    far = np.array([[28.0, 10.0, -0.8], [28.0, 11.0, -1.0], [28.0, 9.0, -0.6]])  # behind the box, through it
    crop = only(seen(), around=far)
    assert len(crop.free) > 12
    assert (np.abs(crop.free) <= BOX[3:6] / 2 + 1e-6).all()
    assert reconstructor().reconstruct(crop).flags == ()


def test_degenerate_crops_are_refused_or_flagged() -> None:
    points = seen()
    enough = points[points[:, 2] > FLOOR_M - 0.75]
    assert only(enough[: FEWEST_POINTS - 1]).refused == "few_points"
    assert only(np.zeros((0, 3)), around=np.array([[5.0, 0.0, 0.0]])).refused == "few_points"
    assert only(enough[:FEWEST_POINTS]).refused == ""
    for column, size in ((3, 14.0), (3, 1.0), (4, 4.0), (5, 0.4)):
        wrong = BOX.copy()
        wrong[column] = size
        assert only(np.random.default_rng(0).uniform(-0.19, 0.19, (50, 3)), wrong).refused == "box_size"


def test_one_side_only_is_flagged() -> None:
    flank = np.column_stack((np.linspace(-1.8, 1.8, 60), np.full(60, 0.9), np.tile([-0.3, 0.0, 0.1], 20)))
    crop = only(flank)
    assert crop.sides == ("left",)
    assert "one_side" in reconstructor().reconstruct(crop).flags
    assert visible_sides(flank * (1, -1, 1), BOX[3:6] / 2) == ("right",)
    assert visible_sides(np.zeros((0, 3)), BOX[3:6] / 2) == ()


@pytest.mark.parametrize("shift", [(0.9, 0.0, 0.0), (0.0, 0.6, 0.0)])
def test_a_box_that_does_not_hold_its_vehicle_is_flagged(shift: tuple[float, float, float]) -> None:
    wrong = reconstructor().reconstruct(only(seen() + shift))
    assert "wrong_box" in wrong.flags


def test_a_box_of_something_else_is_flagged() -> None:
    rng = np.random.default_rng(3)
    bush = rng.uniform(-1, 1, (400, 3)) * (2.0, 0.8, 0.6)
    assert "wrong_box" in reconstructor().reconstruct(only(bush)).flags


def test_a_vehicle_of_its_own_has_its_box_centre_as_origin() -> None:
    found = reconstructor().reconstruct(only(seen()))
    code = subspace().code(found.fit.u)
    vehicle = vehicle_of("kin", VehicleSet().decoder(), code, found.fit.scale_m, np.eye(3))
    mesh = reconstructor().mesh(found.fit)
    assert np.array(vehicle.size_m) == pytest.approx(mesh.extents, rel=0.02)
    assert vehicle.size_m[0] == pytest.approx(LENGTH_M, abs=0.12)
    centre = vehicle.to_sdf(np.zeros((1, 3)))[0]
    assert np.abs(centre).max() < 0.05


def test_a_street_knows_the_vehicles_behind_its_labels() -> None:
    scenes = StreetScenes("hdl64", count=1, split="val")
    (name,) = scenes.names()
    scene, placed = scenes.load(name), scenes.vehicles(name)
    positions = np.stack([vehicle.position for vehicle in placed])
    for box in scene.labels.of_class("vehicle"):
        off = np.linalg.norm(positions - box[:3], axis=1)
        assert off.min() < 1e-9
        mesh = placed[int(off.argmin())].vehicle.intersector
        assert np.ptp(mesh.vertices, axis=0) == pytest.approx(box[3:6], abs=2e-3)
    crops = crop_vehicles(scene)
    inside = points_in_boxes(scene.points, scene.labels.of_class("vehicle"), 0.1).sum(axis=1)
    assert all(crop.points <= count for crop, count in zip(crops, inside))


def test_points_without_a_beam_are_no_points() -> None:
    scene = scene_of(seen(), BOX)
    nowhere = np.zeros((5, 3), np.float32)
    no_return = replace(
        scene, points=np.concatenate((scene.points, nowhere)), origins=np.zeros((len(scene.points) + 5, 3), np.float32)
    )
    (crop,) = crop_vehicles(no_return)
    assert np.array_equal(crop.surface, only(seen()).surface)
