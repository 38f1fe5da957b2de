"""Moving and mounted sensors, the law of power and second returns against closed forms, on handmade walls."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import pytest

from shift3d.scenes.street.build.item import Item, items_overlapping
from shift3d.scenes.street.build.item_geometry import Leaves
from shift3d.scenes.street.build.world import World
from shift3d.scenes.street.raycast import Hits, Intersector, Sweep, hit_instance, hit_leaves
from shift3d.scenes.street.returns import Echoes, Paint, finish, sensor_model
from shift3d.scenes.street.second_hits import SEPARATION_M, second_returns
from shift3d.scenes.street.sensors import AT_ORIGIN, HDL64, SHORT32, WAYMO_TOP, Mount, Sensor
from shift3d.scenes.street.shapes import ALBEDO, Material, Part, box, ellipsoid

SPEED = 20.0
CORNER = Mount((2.0, 1.0, -0.83), np.pi / 4, SPEED)
mounts = pytest.mark.parametrize(
    ("sensor", "mount"),
    [(HDL64, Mount(speed_m_s=SPEED)), (SHORT32, Mount((2.0, 1.0, -0.83), np.pi / 4)), (SHORT32, CORNER)],
)


def world(*parts: Part, foliage: tuple[tuple[int, Leaves], ...] = ()) -> World:
    """Return solid parts, numbered from 0, and leaves."""
    count = 0
    vertices, faces, material, item = [], [], [], []
    for number, part in enumerate(parts):
        vertices.append(part.vertices)
        faces.append(part.faces + count)
        material.append(np.full(len(part.faces), part.material, np.uint8))
        item.append(np.full(len(part.faces), number, np.int32))
        count += len(part.vertices)
    mesh = Intersector(np.concatenate(vertices), np.concatenate(faces))
    return World(mesh, np.concatenate(material), np.concatenate(item), (), foliage, {})


def wall(x: float, y: float = 0.0, width: float = 2000.0, material: Material = Material.FACADE) -> Part:
    """Return a wall with its near face at x; 2 m high enough for every beam on it at 20 m."""
    return box((0.01, width, 1000.0), (x + 0.005, y, -500.0), material)


def cast(place: World, sensor: Sensor = HDL64, mount: Mount = AT_ORIGIN) -> Sweep:
    sweep = Sweep.empty(sensor, mount)
    place.cast(sweep, np.random.default_rng(0))
    return sweep


def echoes(sweep: Sweep, compensated: bool) -> Echoes:
    met = np.isfinite(sweep.range_m)
    return Echoes.of_kept(sweep, met, sweep.range_m, sweep.cosine, compensated)


@mounts
def test_a_wall_ahead_seems_to_come_nearer_during_the_turn(sensor: Sensor, mount: Mount) -> None:
    """A wall at x = 30 is 30 - v t ahead of the sensor at its firing; converted to time 0 it is flat."""
    sweep = cast(world(wall(30.0)), sensor, mount)
    raw, flat = echoes(sweep, compensated=False), echoes(sweep, compensated=True)
    assert len(raw.points) > 4000
    near = np.abs(flat.points[:, 1]) < 60.0  # along a long wall, float32 resolves the range only to millimetres
    np.testing.assert_allclose(flat.points[near, 0], 30.0, atol=1e-3)
    np.testing.assert_allclose(raw.points[near, 0], 30.0 - mount.speed_m_s * raw.time_s[near], atol=1e-3)
    np.testing.assert_allclose(flat.origins[:, 0], mount.origin_m[0] + mount.speed_m_s * flat.time_s, atol=1e-5)
    np.testing.assert_allclose(raw.origins, np.broadcast_to(np.float32(mount.origin_m), raw.origins.shape))
    duration = raw.time_s.max() - raw.time_s.min()
    assert np.ptp(raw.points[near, 0]) > 0.4 * mount.speed_m_s * duration


@mounts
@pytest.mark.parametrize("position", [(12.0, 3.0, -0.9), (4.0, 9.0, -0.5), (-15.0, 0.1, -0.5), (3.0, 1.5, -0.8)])
def test_windows_of_mounted_and_moving_sensors_miss_nothing(
    sensor: Sensor, mount: Mount, position: tuple[float, float, float]
) -> None:
    """Casting near each vehicle in its own frame gives the returns of casting every beam in the scene frame."""
    part = ellipsoid((2.0, 0.9, 0.7), (0.0, 0.0, 0.0), Material.VEHICLE)
    plain = cast(world(part.placed(*position, 0.6)), sensor, mount)
    cos, sin = np.cos(0.6), np.sin(0.6)
    scene_R_object = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    fast, mesh = Sweep.empty(sensor, mount), Intersector(part.vertices, part.faces)
    hit = functools.partial(hit_instance, mesh, scene_R_object, np.array(position), (9.0, 9.0))
    fast.cast_near(np.array(position), 2.01, hit, 0)
    both = np.isfinite(plain.range_m) & np.isfinite(fast.range_m)
    assert (np.isfinite(plain.range_m) != np.isfinite(fast.range_m)).sum() <= 2  # float32 at the silhouette
    np.testing.assert_allclose(fast.range_m[both], plain.range_m[both], atol=5e-4)
    assert both.any() or position[0] < 0.0  # corners do not see past the car


def test_leaves_are_met_where_they_stand_by_a_moving_sensor() -> None:
    centre, radii = np.array([15.0, 4.0, 0.0]), np.array([3.0, 2.0, 2.5])
    sweep = Sweep.empty(HDL64, Mount(speed_m_s=SPEED))
    sweep.cast_near(centre, 3.0, functools.partial(hit_leaves, centre, radii, 0.5, np.random.default_rng(0)), 3)
    points = echoes(sweep, compensated=True).points
    inside = (((points - centre) / radii) ** 2).sum(axis=1)
    assert len(points) > 500 and inside.max() < 1.0 + 1e-5


@pytest.mark.parametrize("sensor", [HDL64, WAYMO_TOP])
@pytest.mark.parametrize("range_m", [20.0, 35.0, 50.0])
def test_returns_are_lost_by_the_law_that_the_sensor_states(sensor: Sensor, range_m: float) -> None:
    """Surfaces near the limit return a share 1 / (1 + (P_min / P)^(1 / spread)), of which drop_rate is lost."""
    model, count, cosine = sensor_model(sensor), 40_000, 0.02
    assert model.limit_range_m is not None
    hits = Hits(
        sensor,
        np.full(count, range_m, np.float32),
        np.zeros(count, np.int32),
        np.full(count, Material.ROAD, np.uint8),
        np.full(count, cosine, np.float32),
    )
    _, _, kept = finish(hits, {}, np.random.default_rng(2))
    power, least = ALBEDO[Material.ROAD] * cosine / range_m**2, 0.9 / model.limit_range_m**2
    expected = (1.0 - sensor.drop_rate) / (1.0 + (least / power) ** (1.0 / model.power_spread))
    sigma = np.sqrt(expected * (1.0 - expected) / count)
    assert abs(kept.mean() - expected) < 3.0 * sigma


class Second(NamedTuple):
    """Cells of second returns, and of the first hits with a search behind them."""

    cells: np.ndarray
    range_m: np.ndarray
    kept: np.ndarray
    sweep: Sweep


def second(place: World, paint: dict[int, Paint] | None = None) -> Second:
    """Return second returns if every first hit is a first return at its exact range."""
    sweep = cast(place)
    kept = np.isfinite(sweep.range_m)
    cells, range_m, _ = second_returns(place, sweep, sweep.range_m, kept, paint or {}, np.random.default_rng(3))
    return Second(np.stack(cells, axis=1), range_m, kept, sweep)


def expected_range_m(found: Second, x: float) -> np.ndarray:
    """Return the range of a wall at x along the beams of second returns."""
    return np.asarray(x / found.sweep.directions[found.cells[:, 0], found.cells[:, 1], 0])


def assert_on_wall(found: Second, x: float) -> None:
    off = found.range_m - expected_range_m(found, x)
    noise = HDL64.range_noise_m
    assert np.abs(off).max() < 6.0 * noise and off.std() < 1.2 * noise


def test_behind_loose_leaves_lies_what_a_share_of_the_beam_reaches() -> None:
    """A bush too small for two echoes of its own is in front of a wall: all beams through the bush reach the wall."""
    bush = Leaves(np.array([10.0, 0.0, -0.5]), np.full(3, 0.45), 0.2)
    found = second(world(wall(16.0), foliage=((7, bush),)))
    leaves = found.sweep.material == Material.FOLIAGE
    assert leaves[found.cells[:, 0], found.cells[:, 1]].all()
    assert_on_wall(found, 16.0)
    # Light of a share s of the beam's, s uniform, returns with 1 / (1 + (P_min / s P)^(1 / spread)).
    model, share = sensor_model(HDL64), (np.arange(1000) + 0.5) / 1000
    assert model.limit_range_m is not None
    power = share * ALBEDO[Material.FACADE] / 16.0**2 / (0.9 / model.limit_range_m**2)
    expected = (1.0 - HDL64.drop_rate) * (1.0 / (1.0 + power ** (-1.0 / model.power_spread))).mean()
    count = int(leaves.sum())
    assert abs(len(found.cells) / count - expected) < 3.0 * np.sqrt(expected * (1.0 - expected) / count)


def test_two_echoes_nearer_than_a_pulse_are_one() -> None:
    bush = Leaves(np.array([10.0, 0.0, -0.5]), np.full(3, 0.45), 0.2)
    assert len(second(world(wall(10.5), foliage=((7, bush),))).cells) == 0


def test_windows_let_through_what_they_do_not_send_back() -> None:
    place = world(wall(16.0), wall(10.0, width=4.0, material=Material.GLASS))
    clear, tinted = second(place, {1: Paint(0.3, 0.8)}), second(place, {1: Paint(0.3, 0.0)})
    glass = clear.sweep.material == Material.GLASS
    assert len(clear.cells) > 0.9 * glass.sum()
    assert_on_wall(clear, 16.0)
    through = glass[tinted.cells[:, 0], tinted.cells[:, 1]]
    assert not through.any()


@pytest.mark.parametrize(("inside_rad", "cut"), [(0.3e-3, True), (0.9e-3, True), (1.1e-3, False), (1.5e-3, False)])
def test_silhouettes_split_the_beams_whose_cone_they_cut(inside_rad: float, cut: bool) -> None:
    """A plate ends inside_rad to the left of one column, whose cone of 1 mrad to each side reaches past it, or not."""
    column = HDL64.columns // 2 - 40
    edge = 10.0 * np.tan(HDL64.azimuths_rad()[column] + inside_rad)
    plate = wall(10.0, edge - 6.0, 12.0)
    found = second(world(wall(30.0), plate))
    on_plate = found.sweep.item == 1
    assert on_plate[:, column].all() and not on_plate[:, column - 1].any()
    left = found.cells[found.cells[:, 1] == column]
    if cut:
        assert len(left) > 0.9 * len(HDL64.elevations_rad)
        assert_on_wall(found, 30.0)
    else:
        assert len(left) == 0
    # Its other end is between two columns; nothing else splits a beam.
    assert len(np.unique(found.cells[:, 1])) <= 2


def test_ground_at_a_grazing_angle_and_hedges_split_no_beam() -> None:
    ground = box((2000.0, 2000.0, 1.0), (0.0, 0.0, -HDL64.mount_height_m - 1.0), Material.ROAD)
    assert len(second(world(ground)).cells) == 0
    hedge = wall(10.0, width=4.0, material=Material.FOLIAGE)
    found = second(world(wall(16.0), hedge))
    inside = np.abs(10.0 * np.tan(HDL64.azimuths_rad()[found.cells[:, 1]])) < 1.9
    assert not inside.any()


def test_second_returns_lie_a_pulse_behind_the_first() -> None:
    crown = Leaves(np.array([12.0, 0.0, 0.0]), np.full(3, 4.0), 1.0)
    found = second(world(wall(40.0), foliage=((7, crown),)))
    first = found.sweep.range_m[found.cells[:, 0], found.cells[:, 1]]
    assert (found.range_m - first >= SEPARATION_M - 1e-5).all()
    among_leaves = found.range_m < 25.0
    assert among_leaves.any() and not among_leaves.all()


def test_what_stands_in_a_rectangle() -> None:
    def at(x: float, y: float, heading: float = 0.0) -> Item:
        return Item("vehicle", x, y, heading, (4.0, 2.0, 1.5))

    items = (at(6.0, 0.0), at(6.0, 2.3), at(6.0, 2.3, np.pi / 2), at(-6.0, 0.0), at(9.0, 0.0))
    assert items_overlapping(items, 4.0, 0.0, 4.0, 2.4).tolist() == [True, False, True, False, False]
    assert items_overlapping((), 4.0, 0.0, 4.0, 2.4).tolist() == []
