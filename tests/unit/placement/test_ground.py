"""The plane under a vehicle: exact on planes, robust to objects on them, and absent where no ground bears it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic_fields import Frame, box, in_frame
from hills import SENSOR_M, patch, raised, slope_scan

from shift3d.geometry.se3 import scene_from_object, scene_R_object
from shift3d.placement.constraints import Constraints
from shift3d.placement.ground import MAX_SLOPE, GroundPlane, fit_ground, ground_under
from shift3d.placement.sampling import Placement, PlacementContext, PlacementLimits, place
from shift3d.render import Beams, preset
from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.scene import Scene

RADIUS_M = 2.9
AT = (18.0, -4.0)
SLOPES = [(0.0, 0.0), (0.05, -0.03), (-0.07, 0.06), (0.0, 0.095)]


def found(points: np.ndarray, at: tuple[float, float] = AT, nominal_z_m: float = -SENSOR_M) -> GroundPlane:
    plane = ground_under(points, at, nominal_z_m, RADIUS_M)
    assert plane is not None
    return plane


def is_plane(plane: GroundPlane, slopes: tuple[float, float], height_m: float, within: float) -> None:
    assert plane.height_m == pytest.approx(height_m, abs=within)
    assert (plane.slope_x, plane.slope_y) == pytest.approx(slopes, abs=within)


@pytest.mark.parametrize("slopes", SLOPES)
def test_a_plane_is_found_as_it_is(slopes: tuple[float, float]) -> None:
    is_plane(found(patch(AT, slopes, 300)), slopes, -SENSOR_M, 1e-9)


def stood(slopes: tuple[float, float], seed: int, nominal_z_m: float = -SENSOR_M) -> Placement:
    """Place a box of 4.0 x 1.8 x 1.4 m on a scanned hillside."""
    frame, settings = Frame((4.0, 1.8, 1.4)), preset("standard").with_(dtype=torch.float64)
    beams = Beams.from_arrays(slope_scan(*slopes).astype(np.float32), np.zeros(3))
    limits = PlacementLimits(8.0, 14.0, sector=(0.0, 1.0), attempts=40)
    rules = Constraints(min_object_points=100)
    crate = in_frame(box((2.0, 0.9, 0.7)), frame)
    placed = place(
        PlacementContext(beams, nominal_z_m), crate, frame, np.random.default_rng(seed), limits, rules, settings
    )
    assert isinstance(placed, Placement) and placed.check.valid
    return placed


@pytest.mark.parametrize("slopes", SLOPES)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_vehicle_stands_on_its_wheels_on_a_slope(slopes: tuple[float, float], seed: int) -> None:
    """The vehicle's up direction is the plane's normal, and the corners of its box are on the plane."""
    placed = stood(slopes, seed)
    normal = torch.tensor([-slopes[0], -slopes[1], 1.0], dtype=torch.float64)
    normal /= normal.norm()
    assert float(scene_R_object(placed.theta)[:, 2] @ normal) == pytest.approx(1.0, abs=1e-6)
    corners = torch.tensor([[x, y, -0.7] for x in (-2.0, 2.0) for y in (-0.9, 0.9)], dtype=torch.float64)
    above = (scene_from_object(corners, placed.theta) @ normal) + SENSOR_M * normal[2]
    # Parallel to the plane, to the accuracy of snapping, which ends within 4 mm, and of the scan's rounding.
    assert np.ptp(above.numpy()) <= 0.001 and above.abs().max() <= 0.005


def test_ground_that_the_nominal_height_misses_serves_where_nothing_else_does() -> None:
    """The same draw is tried again with the same heading, after every plain draw was refused."""
    placed = stood((0.0, 0.0), seed=0, nominal_z_m=-SENSOR_M - 1.1)
    plain = stood((0.0, 0.0), seed=0)
    assert placed.attempts == 40 and plain.attempts < 40
    assert torch.allclose(placed.theta, plain.theta, atol=0.005)


def test_ground_that_climbs_away_from_its_nominal_height_is_found() -> None:
    """The ground forty metres up a hill of nine in a hundred is 3.6 m above that under the sensor."""
    slopes, at = (0.09, 0.0), (40.0, 0.0)
    hill = raised(patch(at, slopes, 300), 3.6)
    plane = found(hill, at)
    is_plane(plane, slopes, 3.6 - SENSOR_M, 1e-9)
    assert fit_ground(hill, at, -SENSOR_M, RADIUS_M) is None


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.06, -0.04)])
def test_what_stands_on_the_ground_does_not_tilt_it(slopes: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    ground = patch(AT, slopes, 200, noise_m=0.01)
    kerb = patch(AT, slopes, 60, noise_m=0.01, seed=2)
    kerb = raised(kerb[kerb[:, 1] > AT[1] + 2.0], 0.15)
    wall = np.column_stack((np.full(150, AT[0] + 2.5), rng.uniform(-6, 0, 150), rng.uniform(-1.5, 1.0, 150)))
    is_plane(found(np.vstack((ground, kerb, wall))), slopes, -SENSOR_M, 0.02)


@pytest.mark.parametrize("ground", [30, 60, 200])
def test_the_roof_of_a_car_is_no_ground(ground: int) -> None:
    """The roof is no ground, whether the road around it has more returns or fewer."""
    roof = raised(patch(AT, (0.0, 0.0), 400, noise_m=0.01), 1.4)
    roof = roof[(np.abs(roof[:, 0] - AT[0]) < 1.8) & (np.abs(roof[:, 1] - AT[1]) < 0.8)]
    road = patch(AT, (0.02, 0.0), 4 * ground, noise_m=0.01, seed=3)
    road = road[np.abs(road[:, 1] - AT[1]) > 1.0][:ground]
    is_plane(found(np.vstack((roof, road))), (0.02, 0.0), -SENSOR_M, 0.03)


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.03, -0.02)])
def test_sparse_rings_bear_a_plane_together(slopes: tuple[float, float]) -> None:
    """The next scan line at fifty metres is 5 m away: one line alone leaves the slope across it open."""
    at = (50.0, 0.0)
    azimuth = np.linspace(-0.15, 0.15, 120)
    rings = [np.column_stack((r * np.cos(azimuth), r * np.sin(azimuth))) for r in (45.0, 50.0, 55.0)]
    xy = np.concatenate(rings)
    z = -SENSOR_M + (xy - at) @ slopes + np.random.default_rng(0).normal(0.0, 0.01, len(xy))
    scan = np.column_stack((xy, z))
    is_plane(found(scan, at), slopes, -SENSOR_M, 0.02)
    assert ground_under(scan[120:240], at, -SENSOR_M, RADIUS_M) is None
    assert ground_under(scan[np.abs(xy[:, 0] - 50) > 2.5], at, -SENSOR_M, RADIUS_M) is None, "nothing under it"


def test_steeper_ground_is_measured_and_cliffs_are_none() -> None:
    plane = found(patch(AT, (0.13, 0.0), 300))
    assert plane.slope == pytest.approx(0.13, abs=1e-9) and plane.slope > MAX_SLOPE
    assert ground_under(patch(AT, (0.5, 0.0), 300), AT, -SENSOR_M, RADIUS_M) is None


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.array([[18.0, -4.0, -1.7]]),
        np.array([[17.0, -5.0, -1.7], [18.0, -4.0, -1.7], [19.0, -3.0, -1.7]]),  # on one line
        np.repeat([[18.0, -4.0, -1.7]], 500, axis=0),
        np.column_stack((np.linspace(15.5, 20.5, 200), np.full(200, -4.0), np.full(200, -1.7))),
    ],
)
def test_too_little_bears_no_plane(points: np.ndarray) -> None:
    with np.errstate(all="raise"):
        assert ground_under(points, AT, -SENSOR_M, RADIUS_M) is None


@pytest.mark.parametrize("angle", [0.4, 1.7, -2.9])
@pytest.mark.parametrize("rise", [0.0, 1.9])
def test_a_turned_scene_has_the_turned_plane(angle: float, rise: float) -> None:
    """rise: more than the nominal height explains, so that the second search answers."""
    bushes = raised(patch(AT, (0.0, 0.0), 40, 0.2, 4), 1.0)
    points = raised(np.vstack((patch(AT, (0.05, 0.03), 200, 0.02), bushes)), rise)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    plane = found(points, AT)
    turned = found(np.column_stack((points[:, :2] @ turn.T, points[:, 2])), tuple(turn @ AT))
    is_plane(turned, tuple(turn @ (plane.slope_x, plane.slope_y)), plane.height_m, 1e-9)
    yaw = 0.7
    assert turned.attitude(yaw + angle) == pytest.approx(plane.attitude(yaw), abs=1e-9)


def measured(scene: Scene) -> str:
    """Return distances of returns from the plane fitted to the others, at places with ground, in centimetres."""
    points = scene.points[scene.has_beam].astype(np.float64)
    rng, planes, errors = np.random.default_rng(0), 0, []
    for _ in range(40):
        at, azimuth = rng.uniform(15.0, 35.0), rng.uniform(-0.7, 0.7)
        x, y = at * math.cos(azimuth), at * math.sin(azimuth)
        near = points[np.hypot(points[:, 0] - x, points[:, 1] - y) < RADIUS_M]
        plane = ground_under(near[::2], (x, y), scene.ground_z_m, RADIUS_M)
        if plane is None:
            continue
        planes += 1
        assert np.isfinite((plane.height_m, plane.slope_x, plane.slope_y)).all()
        others = near[1::2]
        off = others[:, 2] - plane.height_m - (others[:, :2] - (x, y)) @ (plane.slope_x, plane.slope_y)
        errors.append(off[np.abs(off) < 0.3])
    p50, p95 = np.percentile(np.abs(np.concatenate(errors)), (50, 95)) * 100
    return f"{scene.dataset} {scene.scene_id}: {planes} of 40 planes, others off by {p50:.1f} cm, p95 {p95:.1f}"


@pytest.mark.parametrize("name", ["kitti", "argoverse2"])
def test_ground_of_real_frames(real_data: Callable[[str], Path], name: str) -> None:
    root = real_data(name)
    scenes = KittiScenes(root) if name == "kitti" else Argoverse2Scenes(root / "val")
    for scene in scenes.names()[:2]:
        print(measured(scenes.load(scene)))
