"""Overlap, contact, snapping to the ground, and the ground under an object."""

import math

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, box, ground_scan, in_frame
from torch import Tensor

from shift3d.geometry.se3 import scene_from_object, scene_R_object
from shift3d.placement.constraints import Constraints, check, points_near, snap_to_ground
from shift3d.placement.ground import fit_ground
from shift3d.placement.sampling import pose_on_plane
from shift3d.render import Beams
from shift3d.render.field.object_field import ObjectField

SIZE = torch.tensor([4.0, 2.0, 1.5], dtype=torch.float64)
FIELD = ObjectField.of(in_frame(box((2.0, 1.0, 0.75)), SHAPENET_FRAME), SHAPENET_FRAME, torch.float64, 4096)
LIMITS = Constraints()


def held(points: list[list[float]], theta: Tensor | None = None, object_points: int = 300):  # type: ignore[no-untyped-def]
    theta = torch.zeros(6, dtype=torch.float64) if theta is None else theta
    return check(FIELD, torch.tensor(points, dtype=torch.float64).reshape(-1, 3), theta, SIZE, object_points, LIMITS)


@pytest.mark.parametrize(
    "height_m, overlap_ok, contact_ok",
    [
        (-0.70, False, False),
        (-0.729, False, False),
        (-0.731, True, True),
        (-0.75, True, True),
        (-0.769, True, True),
        (-0.771, True, False),
    ],
)
def test_overlap_and_contact_at_two_centimetres(height_m: float, overlap_ok: bool, contact_ok: bool) -> None:
    # One point under the middle of the floor, which is at z = -0.75.
    found = held([[0.0, 0.0, height_m]])
    assert (found.overlap_ok, found.contact_ok) == (overlap_ok, contact_ok)
    assert found.deepest_m == pytest.approx(-0.75 - height_m)
    assert found.valid == (overlap_ok and contact_ok)


def test_contact_is_not_given_by_a_far_point() -> None:
    # The literal reading of the paper's sentence would accept this.
    assert not held([[30.0, 0.0, 0.0]]).contact_ok
    assert not held([]).contact_ok and held([]).overlap_ok


def test_too_few_object_points_are_not_valid() -> None:
    assert held([[0, 0, -0.75]], object_points=300).valid
    assert not held([[0, 0, -0.75]], object_points=299).valid


def test_the_pose_is_taken_into_account() -> None:
    theta = torch.tensor([20.0, 5.0, -1.0, 0.7, 0.05, -0.02], dtype=torch.float64)
    under = scene_from_object(torch.tensor([[0.5, 0.2, -0.76]], dtype=torch.float64), theta)
    assert held(under.tolist(), theta).nearest_m == pytest.approx(0.01, abs=1e-9)


@pytest.mark.parametrize("start_m", [-0.06, -0.01, 0.0, 0.02, 0.2])
def test_snapping_ends_in_touch(start_m: float) -> None:
    ground = torch.cartesian_prod(torch.linspace(-3, 3, 25), torch.linspace(-3, 3, 25)).double()
    points = torch.cat((ground, torch.full((len(ground), 1), -1.73).double()), 1)
    theta = torch.tensor([0.0, 0.0, -0.98 + start_m, 0.4, 0.0, 0.0], dtype=torch.float64)
    found = snap_to_ground(FIELD, points, theta, SIZE)
    assert found is not None
    assert float(found[2]) == pytest.approx(-0.98, abs=0.004)
    assert torch.equal(found[[0, 1, 3, 4, 5]], theta[[0, 1, 3, 4, 5]])
    after = check(FIELD, points, found, SIZE, 300, LIMITS)
    assert after.valid


def test_snapping_gives_up_without_ground_and_beyond_reach() -> None:
    theta = torch.zeros(6, dtype=torch.float64)
    assert snap_to_ground(FIELD, torch.zeros(0, 3).double(), theta, SIZE) is None
    deep = torch.tensor([[0.0, 0.0, -0.3]], dtype=torch.float64)
    assert snap_to_ground(FIELD, deep, theta, SIZE, reach_m=0.1) is None


def test_ground_plane_of_a_slope_under_a_wall() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-3, 3, (400, 2)) + np.array([20.0, 5.0])
    z = -1.6 + 0.05 * (xy[:, 0] - 20) - 0.03 * (xy[:, 1] - 5) + rng.normal(0, 0.01, 400)
    wall = np.column_stack((np.full(200, 22.5), rng.uniform(2, 8, 200), rng.uniform(-1.4, 1.0, 200)))
    plane = fit_ground(np.vstack((np.column_stack((xy, z)), wall)), (20.0, 5.0), -1.73, 3.0)
    assert plane is not None
    assert plane.height_m == pytest.approx(-1.6, abs=0.01)
    assert (plane.slope_x, plane.slope_y) == pytest.approx((0.05, -0.03), abs=0.005)


def test_no_ground_where_none_is_seen() -> None:
    assert fit_ground(np.zeros((0, 3)), (20.0, 0.0), -1.73, 3.0) is None
    # A single scan line does not span a plane.
    line = np.column_stack((np.full(50, 20.0), np.linspace(-2, 2, 50), np.full(50, -1.7)))
    assert fit_ground(line, (20.0, 0.0), -1.73, 3.0) is None


@pytest.mark.parametrize("yaw", [0.0, 0.9, math.pi / 2, 4.0])
def test_the_attitude_lays_the_wheels_on_the_plane(yaw: float) -> None:
    points, _ = ground_scan(rings=4, columns=8)
    plane = fit_ground(
        np.array([[x, y, -1.6 + 0.06 * x - 0.04 * y] for x in np.linspace(-3, 3, 9) for y in np.linspace(-3, 3, 9)]),
        (0.0, 0.0),
        -1.6,
        4.0,
    )
    assert plane is not None and len(points)
    theta = pose_on_plane((0.0, 0.0), yaw, plane.height_m, plane.attitude(yaw), 1.5)
    up = scene_R_object(theta)[:, 2]
    normal = torch.tensor([-plane.slope_x, -plane.slope_y, 1.0], dtype=torch.float64)
    assert float(up @ normal / normal.norm()) == pytest.approx(1.0, abs=1e-12)
    assert float(theta[3]) == yaw


def test_points_near_leaves_out_rows_without_a_beam() -> None:
    beams = Beams.from_arrays(np.array([[0, 0, 0], [1, 0, 0], [9, 0, 0]], np.float32), np.zeros(3))
    assert points_near(beams, torch.zeros(6), 2.0).tolist() == [[1.0, 0.0, 0.0]]


def test_a_neighbour_within_six_metres_is_too_near() -> None:
    others = torch.tensor([[6.5, 0.0], [0.0, -5.9]], dtype=torch.float64)
    theta = torch.zeros(6, dtype=torch.float64)
    ground = torch.tensor([[0.0, 0.0, -0.75]], dtype=torch.float64)
    assert check(FIELD, ground, theta, SIZE, 300, LIMITS, others[:1]).valid
    crowded = check(FIELD, ground, theta, SIZE, 300, LIMITS, others)
    assert not crowded.clear_ok and not crowded.valid
    assert check(FIELD, ground, theta, SIZE, 300, LIMITS, others[:0]).valid
