"""Codes and boxes are inverse to each other; the direction bin decides the half turn."""

from math import pi

import pytest
import torch

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID, full_window
from shift3d.detectors.models.anchor_heads import (
    WAYMO_ANCHORS,
    anchor_boxes,
    decode_boxes,
    direction_bins,
    encode_boxes,
)
from shift3d.detectors.models.network import proposal_indices

SMALL = BevWindow(20, 40, 8, 12, 24, 44, 4, 4)


def test_anchors_of_the_full_grid() -> None:
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, full_window(WAYMO_GRID))
    assert anchors.shape == (468 * 468 * 2, 7)
    first, last = anchors[0], anchors[-1]
    assert first.tolist() == pytest.approx([-74.72, -74.72, 0.885, 4.73, 2.08, 1.77, 0.0])
    assert last.tolist() == pytest.approx([74.72, 74.72, 0.885, 4.73, 2.08, 1.77, pi / 2])
    assert torch.equal(proposal_indices(2, WAYMO_GRID, full_window(WAYMO_GRID)), torch.arange(len(anchors)))


def test_anchors_of_a_window_are_rows_of_the_full_grid() -> None:
    full = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, full_window(WAYMO_GRID))
    part = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, SMALL)
    assert len(part) == 4 * 4 * 2
    assert torch.equal(full[proposal_indices(2, WAYMO_GRID, SMALL)], part)


def test_round_trip_for_every_heading() -> None:
    generator = torch.Generator().manual_seed(0)
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, SMALL).double()
    count = len(anchors)
    boxes = anchors.clone()
    boxes[:, :3] += torch.randn(count, 3, generator=generator, dtype=torch.float64)
    boxes[:, 3:6] *= torch.rand(count, 3, generator=generator, dtype=torch.float64) + 0.5
    boxes[:, 6] = torch.linspace(-pi, pi - 1e-9, count, dtype=torch.float64)
    directions = torch.nn.functional.one_hot(direction_bins(boxes[:, 6]), 2).double()
    decoded = decode_boxes(encode_boxes(boxes, anchors), anchors, directions)
    turn = torch.remainder(decoded[:, 6] - boxes[:, 6] + pi, 2 * pi) - pi
    assert turn.abs().max() < 1e-9
    assert torch.allclose(decoded[:, :6], boxes[:, :6], atol=1e-9)


def test_the_other_direction_bin_turns_the_box_round() -> None:
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, SMALL)
    codes = torch.zeros(len(anchors), 7)
    one = decode_boxes(codes, anchors, torch.tensor([[1.0, 0.0]]).expand(len(anchors), 2))
    two = decode_boxes(codes, anchors, torch.tensor([[0.0, 1.0]]).expand(len(anchors), 2))
    turn = torch.remainder(one[:, 6] - two[:, 6], 2 * pi)
    assert torch.allclose(turn, torch.full_like(turn, pi), atol=1e-5)


def test_bins_have_their_border_between_the_anchors() -> None:
    headings = torch.tensor([pi / 4 + 1e-3, 0.0, pi / 2, pi, -pi / 2, 5 * pi / 4 - 1e-3, 5 * pi / 4 + 1e-3])
    assert direction_bins(headings).tolist() == [0, 1, 0, 0, 1, 0, 1]


def test_absurd_size_codes_stay_finite() -> None:
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, SMALL)
    codes = torch.full((len(anchors), 7), 1e4)
    assert torch.isfinite(decode_boxes(codes, anchors, torch.zeros(len(anchors), 2))).all()
