"""Suppression against the plain quadratic reference."""

import numpy as np
import torch

from shift3d.detectors.base import Proposals
from shift3d.detectors.nms import rotated_nms, suppress
from shift3d.geometry.iou import iou_bev


def _boxes(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    boxes = np.zeros((count, 7))
    boxes[:, :2] = rng.uniform(-15, 15, (count, 2))
    boxes[:, 3:6] = rng.uniform(0.5, 1.5, (count, 3)) * (4.5, 2.0, 1.6)
    boxes[:, 6] = rng.uniform(-np.pi, np.pi, count)
    return boxes, np.round(rng.random(count), 2)  # rounded: with ties


def _plain_nms(boxes: np.ndarray, scores: np.ndarray, iou_threshold: float) -> list[int]:
    overlap = iou_bev(boxes, boxes)
    kept: list[int] = []
    for index in sorted(range(len(boxes)), key=lambda i: (-scores[i], i)):
        if all(overlap[index, other] <= iou_threshold for other in kept):
            kept.append(index)
    return kept


def test_equals_the_plain_reference() -> None:
    for seed in range(5):
        for iou_threshold in (0.0, 0.25, 0.7):
            boxes, scores = _boxes(120, seed)
            assert rotated_nms(boxes, scores, iou_threshold).tolist() == _plain_nms(boxes, scores, iou_threshold)


def test_equal_boxes_with_equal_scores_keep_the_first() -> None:
    boxes, _ = _boxes(1, 0)
    assert rotated_nms(np.repeat(boxes, 4, axis=0), np.full(4, 0.5), 0.25).tolist() == [0]


def test_limit_and_nothing() -> None:
    boxes, scores = _boxes(60, 1)
    assert len(rotated_nms(boxes, scores, 1.0, max_kept=7)) == 7
    assert rotated_nms(np.zeros((0, 7)), np.zeros(0), 0.25).tolist() == []


def test_nothing_kept_behind_the_box_asked_for_and_all_before_it_the_same() -> None:
    for seed in range(5):
        boxes, scores = _boxes(120, seed)
        near = np.hypot(boxes[:, 0], boxes[:, 1]) < 5.0
        kept = rotated_nms(boxes, scores, 0.25).tolist()
        first = next(place for place, index in enumerate(kept) if near[index])
        assert rotated_nms(boxes, scores, 0.25, until=near).tolist() == kept[: first + 1]
    assert rotated_nms(boxes, scores, 0.25, until=np.zeros(120, dtype=bool)).tolist() == kept


def test_what_a_detector_does_not_report_neither_counts_nor_suppresses() -> None:
    boxes, scores = _boxes(120, 3)
    reported = torch.arange(120) % 3 > 0
    proposals = Proposals(torch.from_numpy(boxes), torch.logit(torch.from_numpy(scores)), torch.arange(120), reported)
    found = suppress(proposals, 0.0, 0.25)
    alone = Proposals(*(part[reported] for part in (proposals.boxes, proposals.logits, proposals.anchor_index)))
    np.testing.assert_array_equal(found.boxes, suppress(alone, 0.0, 0.25).boxes)


def test_touching_and_degenerate_boxes_do_not_suppress() -> None:
    boxes = np.array([[0, 0, 0, 4, 2, 1, 0], [4, 0, 0, 4, 2, 1, 0], [0, 0, 0, 0, 0, 1, 0]], dtype=float)
    assert rotated_nms(boxes, np.array([0.9, 0.8, 0.7]), 0.1).tolist() == [0, 1, 2]
