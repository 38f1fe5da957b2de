"""Hard cases of the detectors: windows without tokens, ties of suppression, and box codes."""

from __future__ import annotations

import math
from math import pi

import numpy as np
import torch
from cases_voxels import NAN, detector, seen, window
from catalogue import hard_case

from shift3d.detectors.base import Proposals
from shift3d.detectors.grid import WAYMO_GRID
from shift3d.detectors.models.anchor_heads import (
    WAYMO_ANCHORS,
    anchor_boxes,
    decode_boxes,
    direction_bins,
    encode_boxes,
)
from shift3d.detectors.models.token_windows import Tokens, group_by_window
from shift3d.detectors.models.window_transformer import EncoderLayer, TransformerSpec
from shift3d.detectors.nms import rotated_nms, suppress
from shift3d.errors import InputError

AREA = "detector"
SMALL = TransformerSpec(width=16, heads=2, feed_forward=32, blocks=1, window=4, lengths=(3, 7))


def refusal(call: object, *arguments: object) -> str:
    """Return the text of a call's InputError."""
    try:
        call(*arguments)  # type: ignore[operator]
    except InputError as error:
        return str(error)
    raise AssertionError("it was not refused")


@hard_case(
    area=AREA,
    why="a token alone in its window is padded to 30: softmax over the padding would thin it out",
    must="it attends to itself alone: its value, whatever its query, its key and its neighbours in other windows",
    guard="padded slots are masked in the attention",
)
def a_token_alone_in_its_window() -> None:
    torch.manual_seed(0)
    layer = EncoderLayer(SMALL).double()
    cells = np.array([2, 5, 6, 9, 10, 11, 9])
    tokens = Tokens(np.zeros(7, dtype=np.int64), cells, np.array([0, 0, 0, 0, 0, 0, 1]))  # windows of 1, 2 and 4
    features, positions = torch.randn(2, 7, 16, dtype=torch.float64)
    found = layer(features, positions, group_by_window(tokens, SMALL.window, 0, SMALL.lengths))
    middle = layer.norm_attention(features[0] + layer.out(layer.value(features[0])))
    alone = layer.norm_feed_forward(middle + layer.narrow(torch.nn.functional.gelu(layer.widen(middle))))
    assert torch.allclose(found[0], alone, atol=1e-12)


@hard_case(
    area=AREA,
    why="there is no row to attend, to take a maximum of, or to put together: at once, or once far tokens are let go",
    must="the same finite scene as an empty cloud, for both networks, and a gradient of 0",
    guard="a layer without tokens is passed over",
)
def no_point_in_any_window() -> None:
    outer = window("sst")
    x, y = (
        low + 0.5 * WAYMO_GRID.cell_m + cell * WAYMO_GRID.cell_m
        for low, cell in ((WAYMO_GRID.x_min_m, outer.x0), (WAYMO_GRID.y_min_m, outer.y0))
    )
    clouds = [torch.zeros(0, 3), torch.full((5, 3), 500.0), torch.full((5, 3), NAN), torch.tensor([[x, y, 0.5]])]
    for name, same in (("pointpillars", 3), ("sst", 4)):
        logits = [seen(cloud.double(), name) for cloud in clouds[:same]]
        for found, gradient in logits:
            assert torch.isfinite(found).all() and torch.equal(found, logits[0][0]) and not gradient.any()


@hard_case(
    area=AREA,
    why="sorting that is not stable orders equal scores by chance, and suppression keeps what comes first",
    must="of equal scores the box of the lower index first, so that one of two identical boxes is always the first",
    guard="a stable sort",
)
def boxes_with_equal_scores() -> None:
    count = 300
    boxes = np.tile([0.0, 0.0, 0.0, 4.0, 2.0, 1.6, 0.3], (count, 1))
    boxes[:, 0] = 10.0 * (np.arange(count) // 2)  # two at each place
    assert rotated_nms(boxes, np.full(count, 0.5), 0.25).tolist() == list(range(0, count, 2))
    scores = np.repeat(np.random.default_rng(0).choice([0.2, 0.5, 0.8], count // 2), 2)
    by_score = sorted(range(0, count, 2), key=lambda index: (-scores[index], index))
    assert rotated_nms(boxes, scores, 0.25).tolist() == by_score


@hard_case(
    area=AREA,
    why="in float32 every logit above 17 has the score 1, and a tie would leave the order to the anchors",
    must="of two overlapping boxes the one with the higher logit is kept",
    guard="candidates are ordered by their logits",
)
def two_scores_that_round_to_one() -> None:
    boxes = torch.tensor([[10.0, 0.0, 0.8, 4.0, 2.0, 1.6, 0.0], [10.5, 0.0, 0.8, 4.0, 2.0, 1.6, 0.0]])
    for logits in ([18.0, 30.0], [30.0, 18.0]):
        kept = suppress(Proposals(boxes, torch.tensor(logits), torch.arange(2)), 0.1, 0.25)
        assert kept.scores.tolist() == [1.0]
        assert kept.boxes[0, 0] == boxes[int(np.argmax(logits)), 0]


@hard_case(
    area=AREA,
    why="a NaN is not below the threshold, and sorts behind every score",
    must="a proposal whose score is no number is no detection",
    guard="a score must reach the threshold, which a NaN does not",
)
def a_score_that_is_no_number() -> None:
    boxes = torch.tensor([[10.0 * i, 0.0, 0.8, 4.0, 2.0, 1.6, 0.0] for i in range(3)])
    kept = suppress(Proposals(boxes, torch.tensor([NAN, 1.0, NAN]), torch.arange(3)), 0.1, 0.25)
    assert kept.boxes[:, 0].tolist() == [10.0] and np.isfinite(kept.scores).all()


@hard_case(
    area=AREA,
    why="an empty list of kept boxes has no integer type, and cannot index",
    must="no detection: (0, 7) boxes and (0,) scores",
    guard="the kept indices are made integers, also where there are none",
)
def no_score_above_the_threshold() -> None:
    for count in (0, 4):
        none = Proposals(torch.ones(count, 7), torch.full((count,), -40.0), torch.arange(count))
        kept = suppress(none, 0.1, 0.25)
        assert kept.boxes.shape == (0, 7) and kept.scores.shape == (0,)


@hard_case(
    area=AREA,
    why="exp of a size code beyond 88 is infinite in float32, and the overlap of an infinite box is no number",
    must="finite boxes with a positive size, which suppression and overlap can take",
    guard="size codes are clipped at 5 either way before the exponential",
)
def size_codes_beyond_the_exponential() -> None:
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, window())[:6]
    codes = torch.zeros(6, 7)
    codes[:, 3:6] = torch.tensor([1e4, 90.0, 6.0, -6.0, -200.0, -1e30])[:, None]
    boxes = decode_boxes(codes, anchors, torch.zeros(6, 2))
    assert torch.isfinite(boxes).all() and (boxes[:, 3:6] > 0).all()
    assert boxes[:3, 3].tolist() == [float(torch.exp(torch.tensor(5.0)) * 4.73)] * 3
    kept = suppress(Proposals(boxes, torch.zeros(6), torch.arange(6)), 0.1, 0.25)
    assert np.isfinite(kept.boxes).all()


@hard_case(
    area=AREA,
    why="a heading code is a plain difference and may be any number of turns off",
    must="a heading in [-pi, pi) that points where the code says",
    guard="the heading is wrapped after the direction bin was added",
)
def a_heading_code_many_turns_off() -> None:
    turns = torch.tensor([0.0, 1.0, -1.0, 1000.0, -1000.0], dtype=torch.float64)
    headings = torch.tensor([-pi, -pi + 1e-9, -1.0, 0.0, 2.0, pi - 1e-9], dtype=torch.float64)
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, window())[:1].double()
    for heading in headings:
        codes = torch.zeros(len(turns), 7, dtype=torch.float64)
        codes[:, 6] = heading - anchors[0, 6] + 2 * pi * turns
        directions = torch.nn.functional.one_hot(direction_bins(heading[None]), 2).double().expand(len(turns), 2)
        found = decode_boxes(codes, anchors.expand(len(turns), 7), directions)[:, 6]
        assert ((found >= -pi) & (found < pi)).all()
        assert float(torch.cos(found - heading).min()) > 1.0 - 1e-15


@hard_case(
    area=AREA,
    why="pi and -pi are one heading, and so are headings a turn apart: their labels must not differ",
    must="one direction bin for one heading, and a box that decodes to it",
    guard="the direction bin is taken of the heading modulo a turn",
)
def a_labelled_heading_at_the_half_turn() -> None:
    anchors = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, window())[:1].double()
    for heading, same in ((pi, -pi), (0.0, 2 * pi), (-0.5, 2 * pi - 0.5), (2.0, 2.0 - 4 * pi)):
        bins = direction_bins(torch.tensor([heading, same], dtype=torch.float64))
        assert bins[0] == bins[1]
        for angle in (heading, same):
            labelled = anchors.clone()
            labelled[0, 6] = angle
            directions = torch.nn.functional.one_hot(bins[:1], 2).double()
            found = decode_boxes(encode_boxes(labelled, anchors), anchors, directions)[0, 6]
            assert math.cos(float(found) - heading) > 1.0 - 1e-15


@hard_case(
    area=AREA,
    why="a pose that left the finite numbers has no cell, and no integer",
    must="a clear refusal that names the place",
    guard="the disc is checked before it is turned into cells",
)
def a_window_around_no_place() -> None:
    for centre, radius in (((NAN, 0.0), 8.0), ((0.0, math.inf), 8.0), ((0.0, 0.0), NAN)):
        assert "detector window: no disc of" in refusal(detector().window_for, centre, radius)


@hard_case(
    area=AREA,
    why="an object beyond the detector's range has no anchor: its score would be that of nothing",
    must="a clear refusal; at the border a window of what is left of the disc",
    guard="a disc that meets no cell is refused",
)
def an_object_beyond_the_detectors_range() -> None:
    for centre in ((90.0, 0.0), (0.0, -90.0), (1e300, 0.0), (90.0, 90.0)):
        assert "no detector cell within 8 m" in refusal(detector().window_for, centre, 8.0)
    cut = detector().window_for((80.0, 0.0), 8.0)
    assert cut.core_num_x == 12 and cut.core_x0 + cut.core_num_x == WAYMO_GRID.num_x


@hard_case(
    area=AREA,
    why="frames come with a column of reflectance, which a network for x, y, z would take for a coordinate",
    must="a clear refusal that names the shape",
    guard="the shape of the points is checked where they enter",
)
def points_with_reflectance() -> None:
    for points in (torch.zeros(5, 4), torch.zeros(5, 2), torch.zeros(3)):
        assert "not (N, 3)" in refusal(detector().proposals, points, window())
        assert "not (N, 3)" in refusal(detector().incremental(window()).proposals, points)
