"""Poses, boxes, overlaps, box codes and surface distances in float32 against float64, within bounds by operation."""

import math

import numpy as np
import pytest
import torch
import trimesh
from rounding import EMPTY, U32, gamma

from shift3d.detectors.models.anchor_heads import decode_boxes, direction_bins, encode_boxes
from shift3d.geometry.boxes import corners_3d, corners_bev, points_in_boxes
from shift3d.geometry.iou import iou_3d, iou_bev
from shift3d.geometry.se3 import object_from_scene, scene_from_object, scene_R_object
from shift3d.sdf.meshes import distance_to_surface


@pytest.fixture(scope="module")
def poses() -> torch.Tensor:
    """Poses (50, 6), as float32 holds them."""
    rng = np.random.default_rng(0)
    return torch.from_numpy(rng.uniform(-1, 1, (50, 6)) * [40, 40, 3, math.pi, 0.3, 0.3]).float()


def random_boxes(count: int, seed: int) -> np.ndarray:
    """Return (count, 7) float32 boxes close enough to overlap."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-1, 1, (count, 3)) * [4, 4, 0.4] + [30, -12, 0.8]
    size = rng.uniform(0.6, 1.4, (count, 3)) * [4.5, 1.9, 1.6]
    return np.concatenate((centre, size, rng.uniform(-4, 4, (count, 1))), 1).astype(np.float32)


def test_rotations(poses: torch.Tensor) -> None:
    """An entry has at most two products of three sines, accurate to 2 u (libm), two products, a sum: 2 (6 + 3) u."""
    worst = max(float((scene_R_object(p).double() - scene_R_object(p.double())).abs().max()) for p in poses)
    assert EMPTY * gamma(18) < worst < gamma(18)


def test_frames(poses: torch.Tensor) -> None:
    """Three products have entries off by 18 u, and a difference or a sum is added: 24 u of the addends' sizes."""
    generator = torch.Generator().manual_seed(0)
    points = 60 * torch.randn(200, 3, generator=generator)
    worst = 0.0
    for pose in poses:
        exact = pose.double()
        turn = scene_R_object(exact).abs()
        offset = points.double().abs() + exact[:3].abs()
        size_in, size_out = offset @ turn, points.double().abs() @ turn.T + exact[:3].abs()
        error_in = object_from_scene(points, pose).double() - object_from_scene(points.double(), exact)
        error_out = scene_from_object(points, pose).double() - scene_from_object(points.double(), exact)
        share = max(float((error_in.abs() / size_in).max()), float((error_out.abs() / size_out).max()))
        worst = max(worst, share)
    assert EMPTY * gamma(24) < worst < gamma(24)


def test_boxes_are_computed_in_float64_whatever_they_come_in() -> None:
    a, b = random_boxes(40, 0), random_boxes(40, 1)
    wide_a, wide_b = a.astype(np.float64), b.astype(np.float64)
    for function in (corners_bev, corners_3d):
        assert np.array_equal(function(a), function(wide_a)) and function(a).dtype == np.float64
    for overlap in (iou_bev, iou_3d):
        assert np.array_equal(overlap(a, b), overlap(wide_a, wide_b)) and overlap(a, b).dtype == np.float64
    points = (np.random.default_rng(2).normal(size=(500, 3)) * [3, 3, 1] + [30, -12, 0.8]).astype(np.float32)
    assert np.array_equal(points_in_boxes(points, a), points_in_boxes(points.astype(np.float64), wide_a))


def test_what_rounding_a_box_does_to_its_overlap() -> None:
    """A corner moves by at most d = u (|x| + |y| + dx + dy + |heading| r), r half the diagonal.

    An outline of length L that moves by d changes its area by L d, to first order; IoU = I / (A + B - I) by less than 3
    L d / (A + B - I), for both boxes.
    """
    rng = np.random.default_rng(3)
    worst, bound_there = 0.0, 1.0
    for _ in range(400):
        a, b = random_boxes(2, int(rng.integers(1 << 30))).astype(np.float64) + rng.normal(scale=1e-3, size=(2, 7))
        rounded = [box.astype(np.float32)[None] for box in (a, b)]
        exact = iou_bev(a[None], b[None])[0, 0]
        if exact == 0:
            continue
        union = (a[3] * a[4] + b[3] * b[4]) / (1 + exact)
        bound = 0.0
        for box in (a, b):
            moved = U32 * (abs(box[0]) + abs(box[1]) + box[3] + box[4] + 4 * math.hypot(box[3], box[4]) / 2)
            bound += 3 * 2 * (box[3] + box[4]) * moved / union
        change = abs(iou_bev(*rounded)[0, 0] - exact)
        assert change <= bound
        if change / bound > worst / bound_there:
            worst, bound_there = change, bound
    assert worst > 10 * EMPTY * bound_there


def test_box_codes() -> None:
    """Centres: a product and a sum (or a difference and a quotient), the diagonal accurate to 2 u: 5 u of the sizes.

    Sizes: exp and log are accurate to 2 u, log of a quotient that is off by u to u more, absolutely. Heading: three
    sums of at most 3 pi, and the remainder's own pi, which float32 holds to u pi: 8 u of 4 pi.
    """
    anchors = torch.from_numpy(random_boxes(300, 4))
    boxes = torch.from_numpy(random_boxes(300, 5))
    codes = encode_boxes(boxes, anchors)
    exact = encode_boxes(boxes.double(), anchors.double())
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4]).double()[:, None]
    size_xy = (boxes[:, :2].double().abs() + anchors[:, :2].double().abs()) / diagonal
    assert bool(((codes - exact).abs()[:, :2] <= 5 * U32 * size_xy).all())
    assert bool(((codes - exact).abs()[:, 3:6] <= 2 * U32 * (1 + exact[:, 3:6].abs())).all())
    directions = torch.randn(300, 2, generator=torch.Generator().manual_seed(0))
    decoded = decode_boxes(codes, anchors, directions).double()
    truth = decode_boxes(codes.double(), anchors.double(), directions.double())
    size_xy = codes[:, :2].double().abs() * diagonal + anchors[:, :2].double().abs()
    assert bool(((decoded - truth).abs()[:, :2] <= 5 * U32 * size_xy).all())
    assert bool(((decoded - truth).abs()[:, 3:6] <= 5 * U32 * truth[:, 3:6]).all())
    turned = torch.remainder(decoded[:, 6] - truth[:, 6] + math.pi, 2 * math.pi) - math.pi
    # A heading on the edge of a half turn may fall to the other side: headings within their bound are left out.
    half = torch.remainder(truth[:, 6] - math.pi / 4, math.pi)
    plain = (half > 1e-5) & (half < math.pi - 1e-5)
    assert float(turned[plain].abs().max()) <= 8 * U32 * 4 * math.pi and plain.sum() > 290
    assert float((decoded - truth).abs()[:, :2].max()) > EMPTY * 5 * U32 * float(size_xy.max())


def test_direction_bins_are_those_of_float64_away_from_their_edges() -> None:
    heading = torch.linspace(-7.0, 7.0, 4001)
    edge = torch.remainder(heading.double() - math.pi / 4, math.pi)
    plain = (edge > 8 * U32 * 7) & (edge < math.pi - 8 * U32 * 7)
    assert torch.equal(direction_bins(heading)[plain], direction_bins(heading.double())[plain])


def test_surface_distances_are_computed_in_float64() -> None:
    """Distances equal those of the same places; rounding a place changes its distance by at most sqrt(3) u |x|."""
    mesh = trimesh.creation.icosphere(2, radius=1.0)
    points = np.random.default_rng(0).normal(size=(300, 3))
    rounded = points.astype(np.float32)
    assert np.array_equal(distance_to_surface(rounded, mesh), distance_to_surface(rounded.astype(np.float64), mesh))
    change = np.abs(distance_to_surface(rounded, mesh) - distance_to_surface(points, mesh))
    bound = math.sqrt(3) * U32 * np.linalg.norm(points, axis=1)
    assert (change <= bound + 1e-12).all() and (change > EMPTY * bound).any()
