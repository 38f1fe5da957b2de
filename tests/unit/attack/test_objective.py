"""The adversarial loss and the detection score."""

import math

import numpy as np
import pytest
import torch

from shift3d.attack.objective import (
    adversarial_loss,
    detection_score,
    latent_penalty,
    object_box,
    overlap_weights,
    proposal_score,
    to_network_frame,
)
from shift3d.detectors.base import Detections, Proposals

BOX = np.array([10.0, 2.0, 0.8, 4.0, 2.0, 1.6, 0.3])


def proposals(logits: list[float], boxes: np.ndarray | None = None) -> Proposals:
    """Return proposals, by default y* itself, a far box, and y* shifted by half its length along its heading."""
    if boxes is None:
        shifted = BOX.copy()
        shifted[:2] += 2.0 * np.array([math.cos(0.3), math.sin(0.3)])
        far = BOX.copy()
        far[0] += 30.0
        boxes = np.stack((BOX, far, shifted))
    return Proposals(
        torch.from_numpy(boxes).float(),
        torch.tensor(logits, dtype=torch.float64, requires_grad=True),
        torch.arange(len(boxes)),
    )


def test_the_papers_sum() -> None:
    found = proposals([0.4, 3.0, -0.7])
    weights = overlap_weights(found, BOX)
    assert weights.tolist() == pytest.approx([1.0, 0.0, 1.0 / 3.0], abs=1e-5)
    p = torch.sigmoid(found.logits.detach())
    expected = float(-(weights * torch.log(1 - p)).sum())
    assert float(adversarial_loss(found, BOX).detach()) == pytest.approx(expected, rel=1e-9)


def test_only_overlapping_logits_carry_gradient() -> None:
    found = proposals([0.4, 3.0, -0.7])
    adversarial_loss(found, BOX).backward()
    gradient = found.logits.grad
    assert gradient is not None and float(gradient[1]) == 0.0
    assert float(gradient[0]) == pytest.approx(1 / (1 + math.exp(-0.4)), rel=1e-5)
    assert not found.boxes.requires_grad


@pytest.mark.parametrize("logit, slope", [(1e4, 1.0), (-1e4, 0.0), (50.0, 1.0), (-50.0, 0.0)])
def test_saturated_scores_stay_finite(logit: float, slope: float) -> None:
    found = proposals([logit, logit, logit])
    loss = adversarial_loss(found, BOX)
    loss.backward()
    assert math.isfinite(float(loss.detach()))
    assert found.logits.grad is not None
    assert found.logits.grad.tolist() == pytest.approx([slope, 0.0, slope / 3], abs=1e-5)


def test_no_overlap_is_exactly_zero() -> None:
    away = BOX.copy()
    away[1] += 50.0
    loss = adversarial_loss(proposals([5.0, 5.0, 5.0]), away)
    assert float(loss.detach()) == 0.0
    empty = Proposals(torch.zeros(0, 7), torch.zeros(0), torch.zeros(0, dtype=torch.long))
    assert float(adversarial_loss(empty, BOX)) == 0.0
    assert proposal_score(empty, BOX) == 0.0


def test_latent_penalty() -> None:
    assert float(latent_penalty(torch.tensor([3.0, 4.0]), torch.zeros(2))) == 25.0


def test_detection_score_takes_the_best_box_within_five_metres() -> None:
    boxes = np.stack([BOX] * 3)
    boxes[:, 0] += [4.9, 5.1, -1.0]
    found = Detections(boxes, np.array([0.6, 0.9, 0.4]))
    assert detection_score(found, BOX) == 0.6
    assert detection_score(found, BOX, radius_m=2.0) == 0.4
    assert detection_score(Detections(np.zeros((0, 7)), np.zeros(0)), BOX) == 0.0


def test_boxes_and_points_enter_the_network_frame() -> None:
    theta = torch.tensor([10.0, 2.0, -0.93, 0.3, 0.01, 0.02], dtype=torch.float64)
    assert object_box(theta, (4.0, 2.0, 1.6), -1.73).tolist() == pytest.approx(BOX.tolist())
    points = torch.tensor([[1.0, 2.0, -1.73]], requires_grad=True)
    moved = to_network_frame(points, -1.73)
    assert moved.tolist() == [[1.0, 2.0, 0.0]] and moved.requires_grad
