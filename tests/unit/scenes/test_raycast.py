"""Ray casting against closed forms: a flat floor, a wall, and leaves with a known mean free path."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from shift3d.scenes.street.raycast import Intersector, Sweep, beam_directions, hit_instance, hit_leaves
from shift3d.scenes.street.sensors import HDL64, SENSORS, Sensor
from shift3d.scenes.street.shapes import Material, Part, box, ellipsoid, prism

sensors = pytest.mark.parametrize("sensor", list(SENSORS.values()), ids=lambda sensor: str(sensor.name))


def cast(sweep: Sweep, part: Part, item: int = 0) -> Sweep:
    count = len(part.faces)
    mesh = Intersector(part.vertices, part.faces)
    sweep.cast_static(mesh, np.full(count, part.material, np.uint8), np.full(count, item, np.int32))
    return sweep


def floor(sensor: Sensor, half_m: float = 500.0) -> Part:
    return box((2 * half_m, 2 * half_m, 1.0), (0.0, 0.0, -sensor.mount_height_m - 1.0), Material.ROAD)


@sensors
def test_a_ring_on_flat_ground_has_range_height_over_sine(sensor: Sensor) -> None:
    sweep = cast(Sweep.empty(sensor), floor(sensor))
    for row, elevation in enumerate(sensor.elevations_rad):
        if elevation > -0.01:
            continue
        expected = sensor.mount_height_m / np.sin(-elevation)
        np.testing.assert_allclose(sweep.range_m[row], expected, rtol=2e-5)
        np.testing.assert_allclose(sweep.cosine[row], np.sin(-elevation), rtol=1e-3)
    assert np.isinf(sweep.range_m[0]).all()


@sensors
def test_beam_tables_are_those_of_the_sensor(sensor: Sensor) -> None:
    elevations = np.rad2deg(sensor.elevations_rad)
    assert len(elevations) == 64
    assert (np.diff(elevations) < 0).all()
    low, high = {"hdl64": (-24.33, 2.0), "waymo_top": (-17.6, 2.4)}[sensor.name]
    assert elevations[0] == pytest.approx(high, abs=0.1)
    assert elevations[-1] == pytest.approx(low, abs=0.1)
    directions = beam_directions(sensor.name)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-6)


def test_nothing_behind_a_wall_appears() -> None:
    wall = box((0.2, 6.0, 4.0), (10.0, 0.0, -2.0), Material.FACADE)
    hidden = box((2.0, 2.0, 2.0), (15.0, 0.0, -1.73), Material.METAL)
    sweep = cast(cast(cast(Sweep.empty(HDL64), hidden, 1), wall, 2), floor(HDL64), 3)
    assert (sweep.item != 1).all()
    assert (sweep.item == 2).any()
    points = beam_directions("hdl64") * np.where(np.isfinite(sweep.range_m), sweep.range_m, 0.0)[..., None]
    azimuth = np.arctan2(points[..., 1], points[..., 0])
    shadowed = (np.abs(azimuth) < np.arctan2(2.9, 9.9)) & (np.asarray(HDL64.elevations_rad)[:, None] > -0.17)
    assert points[shadowed][:, 0].max() < 10.0


@pytest.mark.parametrize("heading_rad", [0.0, 0.7, np.pi / 2, 3.0])
@pytest.mark.parametrize("position", [(12.0, 3.0, -0.9), (-20.0, 0.1, -0.5), (1.0, 0.5, -1.0), (0.5, -15.0, 0.0)])
def test_an_instance_is_hit_as_the_same_mesh_in_the_scene_frame_is(
    position: tuple[float, float, float], heading_rad: float
) -> None:
    """Culling by window, and casting in the object frame, change nothing (also across the azimuth seam)."""
    part = ellipsoid((2.0, 0.9, 0.7), (0.0, 0.0, 0.0), Material.VEHICLE)
    plain = cast(Sweep.empty(HDL64), part.placed(*position, heading_rad))
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    scene_R_object = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    fast = Sweep.empty(HDL64)
    mesh = Intersector(part.vertices, part.faces)
    hit = functools.partial(hit_instance, mesh, scene_R_object, np.array(position), (9.0, 9.0))
    fast.cast_near(np.array(position), 2.01, hit, 0)
    both = np.isfinite(plain.range_m) & np.isfinite(fast.range_m)
    assert both.sum() > 50
    assert (np.isfinite(plain.range_m) != np.isfinite(fast.range_m)).sum() <= 2  # float32 at the silhouette
    np.testing.assert_allclose(fast.range_m[both], plain.range_m[both], atol=2e-4)


def test_leaves_stop_beams_exponentially() -> None:
    """Beams pass through the middle of a ball of radius r; mean free path m stops a share 1 - exp(-2 r / m)."""
    sweep = Sweep.empty(HDL64)
    centre, radii = np.array([20.0, 0.0, 0.0]), np.full(3, 3.0)
    sweep.cast_near(centre, 3.0, functools.partial(hit_leaves, centre, radii, 2.0, np.random.default_rng(1)), 5)
    directions = beam_directions("hdl64").reshape(-1, 3)
    central = directions @ np.array([1.0, 0.0, 0.0]) > np.cos(0.01)
    stopped = np.isfinite(sweep.range_m.reshape(-1)[central])
    assert stopped.mean() == pytest.approx(1.0 - np.exp(-3.0), abs=0.08)
    met = np.isfinite(sweep.range_m)
    points = directions.reshape(*met.shape, 3)[met] * sweep.range_m[met][:, None]
    assert (np.linalg.norm(points - [20.0, 0.0, 0.0], axis=1) < 3.0 + 1e-4).all()
    assert (sweep.item[met] == 5).all()


@pytest.mark.parametrize(
    "part",
    [
        box((2.0, 1.0, 3.0), (1.0, 2.0, 3.0), Material.METAL, 0.8),
        prism((0.0, 0.0, 0.0), (0.3, 1.0, 2.0), (0.5, 0.2), Material.METAL),
        ellipsoid((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), Material.CLOTH),
    ],
)
def test_parts_are_closed_and_face_outwards(part: Part) -> None:
    edges = np.concatenate([part.faces[:, [0, 1]], part.faces[:, [1, 2]], part.faces[:, [2, 0]]])
    forward = {tuple(edge) for edge in edges.tolist()}
    assert len(forward) == len(edges)
    assert forward == {(b, a) for a, b in forward}
    a, b, c = (part.vertices[part.faces[:, i]] - part.vertices.mean(axis=0) for i in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0.0
