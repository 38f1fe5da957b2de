"""SE(3), boxes and IoU against hand-computed cases and invariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from shift3d.errors import InputError
from shift3d.geometry.boxes import corners_3d, corners_bev, points_in_boxes, validate_boxes
from shift3d.geometry.iou import iou_3d, iou_bev
from shift3d.geometry.se3 import object_from_scene, scene_from_object, scene_R_object, wrap_angle


def test_pose_convention_by_hand() -> None:
    """A car at (10, 5, 0) heading left (+y): the point two metres ahead of it is at (10, 7, 0)."""
    pose = torch.tensor([10.0, 5.0, 0.0, math.pi / 2, 0.0, 0.0], dtype=torch.float64)
    ahead = object_from_scene(torch.tensor([[10.0, 7.0, 0.0]], dtype=torch.float64), pose)
    torch.testing.assert_close(ahead, torch.tensor([[2.0, 0.0, 0.0]], dtype=torch.float64), atol=1e-12, rtol=0)


def test_positive_pitch_lowers_the_nose_and_positive_roll_lowers_the_right_side() -> None:
    nose_and_right = torch.tensor([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], dtype=torch.float64)
    pitched = scene_from_object(nose_and_right, torch.tensor([0, 0, 0, 0, 0.1, 0], dtype=torch.float64))
    rolled = scene_from_object(nose_and_right, torch.tensor([0, 0, 0, 0, 0, 0.1], dtype=torch.float64))
    assert pitched[0, 2] == pytest.approx(-math.sin(0.1))
    assert rolled[1, 2] == pytest.approx(-math.sin(0.1))


def test_rotation_equals_product_of_elementary_rotations() -> None:
    yaw, pitch, roll = 0.3, -0.2, 0.7
    rz = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    ry = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    rx = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    pose = torch.tensor([0, 0, 0, yaw, pitch, roll], dtype=torch.float64)
    np.testing.assert_allclose(scene_R_object(pose).numpy(), rz @ ry @ rx, atol=1e-15)


def test_pose_gradient_matches_finite_differences() -> None:
    points = torch.randn(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    pose = torch.tensor([3.0, -2.0, 1.0, 3.1, 0.05, -0.08], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: object_from_scene(points, p), (pose,))


@given(
    st.one_of(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4, width=32)),
    st.one_of(st.none(), st.tuples(st.integers(-1500, 1500), st.integers(-4, 4), st.sampled_from([np.float32, float]))),
)
def test_wrap_angle_keeps_the_direction(angle: float, edge: tuple[int, int, type] | None) -> None:
    """edge: an integer number of half turns, some floats farther, of either width."""
    if edge is not None:
        half_turns, steps, width = edge
        angle = float(width(half_turns * math.pi) + steps * np.spacing(width(half_turns * math.pi)))
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)


def test_corners_and_containment_by_hand() -> None:
    box = np.array([[1.0, 2.0, 3.0, 4.0, 2.0, 1.0, math.pi / 2]])
    np.testing.assert_allclose(corners_bev(box)[0], [(0, 4), (0, 0), (2, 0), (2, 4)], atol=1e-12)
    assert corners_3d(box)[0, :, 2].tolist() == [2.5] * 4 + [3.5] * 4
    points = np.array([[1.0, 3.9, 3.0], [2.9, 2.0, 3.0], [1.0, 2.0, 3.6]])
    assert points_in_boxes(points, box).tolist() == [[True, False, False]]


def test_iou_by_hand() -> None:
    unit = np.array([[0, 0, 0, 2.0, 2.0, 2.0, 0.0]])
    shifted = np.array([[1.0, 0, 1.0, 2.0, 2.0, 2.0, 0.0]])
    turned = np.array([[0, 0, 0, 2.0, 2.0, 2.0, math.pi / 4]])
    assert iou_bev(unit, shifted)[0, 0] == pytest.approx(2 / 6)
    assert iou_3d(unit, shifted)[0, 0] == pytest.approx(2 / 14)
    octagon = 8 * (math.sqrt(2) - 1)  # of inradius 1
    assert iou_bev(unit, turned)[0, 0] == pytest.approx(octagon / (8 - octagon))


def test_iou_3d_of_boxes_above_each_other() -> None:
    """Boxes of height 2 on one footprint: sharing half gives 1 / 3, a quarter 0.5 / 3.5; nested boxes their ratio."""
    base = np.array([[1.0, 2.0, 0.0, 4.0, 2.0, 2.0, 0.7]])
    others = np.repeat(base, 5, axis=0)
    others[:, 2] = [0.0, 1.0, -1.5, 2.0, 3.0]
    np.testing.assert_allclose(iou_3d(base, others)[0], [1.0, 1 / 3, 0.5 / 3.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(iou_bev(base, others)[0], 1.0, atol=1e-12)
    inner = base.copy()
    inner[0, 5] = 0.5
    assert iou_3d(base, inner)[0, 0] == pytest.approx(0.25)
    assert iou_3d(base, others).dtype == np.float64 and iou_3d(np.zeros((0, 7)), others).shape == (0, 5)


def test_iou_of_just_touching_empty_and_no_boxes() -> None:
    unit = np.array([[0, 0, 0, 2.0, 2.0, 2.0, 0.0]])
    touching = np.array([[2.0, 0, 0, 2.0, 2.0, 2.0, 0.0]])
    flat = np.array([[0, 0, 0, 0.0, 0.0, 0.0, 0.0]])
    assert iou_bev(unit, touching)[0, 0] == 0.0
    assert iou_bev(flat, flat)[0, 0] == 0.0
    assert iou_bev(np.zeros((0, 7)), unit).shape == (0, 1)


coordinate = st.floats(-5, 5)
box = st.tuples(coordinate, coordinate, coordinate, *[st.floats(0.3, 6)] * 3, st.floats(-10, 10))


@settings(max_examples=60, deadline=None)
@given(box, box, st.floats(-4, 4), st.floats(-20_000, 20_000))
def test_iou_is_symmetric_and_invariant_under_rigid_motion(a: tuple, b: tuple, turn: float, shift: float) -> None:
    a, b = np.array([a]), np.array([b])
    before = iou_bev(a, b)[0, 0]
    assert iou_bev(b, a)[0, 0] == pytest.approx(before, abs=1e-9)
    assert iou_bev(a, a)[0, 0] == pytest.approx(1.0, abs=1e-9)
    moved = []
    for item in (a.copy(), b.copy()):
        x, y = item[0, :2]
        item[0, 0] = np.cos(turn) * x - np.sin(turn) * y + shift
        item[0, 1] = np.sin(turn) * x + np.cos(turn) * y - shift
        item[0, 6] += turn
        moved.append(item)
    # 20 km away a coordinate has an error of 4e-12 m; relative coordinates keep the overlap to about that.
    assert iou_bev(*moved)[0, 0] == pytest.approx(before, abs=1e-8)


def test_bad_boxes_are_named() -> None:
    with pytest.raises(InputError, match=r"box 0 has dz = -1\.0"):
        validate_boxes(np.array([[0, 0, 0, 1, 1, -1.0, 0]]), "labels")
