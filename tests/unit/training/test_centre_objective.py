"""Targets and losses of heads without anchors: peaks, their decoded boxes, and entries without training."""

from __future__ import annotations

from math import pi

import pytest
import torch

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID
from shift3d.detectors.models.centre_heads import CentreHeads, decode_centres, encode_centres
from shift3d.training.detector.centre_objective import CentreObjective, assign_centres, gaussian_radius, heat_map_loss
from shift3d.training.detector.recipe import Recipe

WINDOW = BevWindow(214, 214, 40, 40, 214, 214, 40, 40)
VEHICLE = torch.tensor([[0.3, -0.7, 0.8, 4.4, 1.8, 1.5, 2.9]])
YES, NO = torch.tensor([True]), torch.tensor([False])


def _cells(indices: torch.Tensor) -> torch.Tensor:
    return torch.stack((indices % 40 + 214, indices // 40 + 214), dim=1)


def test_codes_and_boxes_are_inverse() -> None:
    generator = torch.Generator().manual_seed(0)
    boxes = torch.rand(50, 7, generator=generator) * torch.tensor([60, 60, 2, 6, 2, 2, 2 * pi])
    boxes -= torch.tensor([30, 30, 1, -1, -1, -1, pi])
    cells = torch.randint(0, 468, (50, 2), generator=generator)
    back = decode_centres(encode_centres(boxes.double(), cells, WAYMO_GRID), cells, WAYMO_GRID)
    assert torch.allclose(back, boxes.double(), atol=1e-9)


def test_a_box_of_no_code_is_finite() -> None:
    assert torch.isfinite(decode_centres(torch.full((1, 8), 1e4), torch.zeros(1, 2), WAYMO_GRID)).all()


def test_targets_decode_to_the_vehicle_and_peak_at_its_cell() -> None:
    target = assign_centres(WAYMO_GRID, WINDOW, VEHICLE, YES, centre_radius=1)
    peak = int(target.heat.argmax())
    # x = 0.3 is in column floor(75.18 / 0.32), y = -0.7 in line floor(74.18 / 0.32).
    assert _cells(torch.tensor([peak])).tolist() == [[234, 231]]
    assert target.heat.max() == 1.0 and (target.heat == 1.0).sum() == 1
    assert len(target.positives) == 9 and peak in target.positives.tolist()
    assert torch.allclose(decode_centres(target.codes, _cells(target.positives), WAYMO_GRID), VEHICLE.expand(9, 7))
    alone = assign_centres(WAYMO_GRID, WINDOW, VEHICLE, YES, centre_radius=0)
    assert alone.positives.tolist() == [peak]


def test_the_radius_keeps_a_tenth_of_overlap() -> None:
    for length, width in ((13.75, 5.6), (30.0, 8.0)):
        radius = gaussian_radius(length, width)
        inner = (length - radius) * (width - radius)
        assert inner / (2 * length * width - inner) >= 0.1
        wider = (length - radius - 1) * max(0.0, width - radius - 1)
        assert wider / (2 * length * width - wider) < 0.1
    assert gaussian_radius(0.5, 0.5) == 2


def test_around_vehicles_with_few_points_nothing_is_trained() -> None:
    unseen = assign_centres(WAYMO_GRID, WINDOW, VEHICLE, NO, centre_radius=1)
    assert not len(unseen.positives) and unseen.heat.max() == 0.0 and not unseen.trained.all()
    nothing = assign_centres(WAYMO_GRID, WINDOW, torch.zeros(0, 7), torch.zeros(0, dtype=torch.bool), 1)
    assert nothing.trained.all() and nothing.heat.max() == 0.0
    outside = VEHICLE + torch.tensor([50.0, 0, 0, 0, 0, 0, 0])
    assert assign_centres(WAYMO_GRID, WINDOW, outside, YES, 1).heat.max() == 0.0


def test_a_cell_of_two_vehicles_draws_the_nearer_one() -> None:
    pair = torch.cat((VEHICLE, VEHICLE + torch.tensor([0.32, 0, 0, 0, 0, 0, 0])))
    target = assign_centres(WAYMO_GRID, WINDOW, pair, torch.tensor([True, True]), centre_radius=1)
    boxes = decode_centres(target.codes, _cells(target.positives), WAYMO_GRID)
    centres = WAYMO_GRID.x_min_m + (_cells(target.positives)[:, 0] + 0.5) * 0.32
    assert ((boxes[:, 0] - centres).abs() <= (centres[:, None] - pair[:, 0]).abs().min(dim=1).values + 1e-4).all()
    assert len(target.positives) == 12


def test_the_heat_map_s_loss_in_closed_form() -> None:
    logits = torch.tensor([0.0, 0.0, 100.0, -100.0], requires_grad=True)
    loss = heat_map_loss(logits, torch.tensor([1.0, 0.5, 0.0, 1.0]))
    log2 = float(torch.log(torch.tensor(2.0)))
    assert loss.tolist() == pytest.approx([0.25 * log2, 0.5**4 * 0.25 * log2, 100.0, 100.0], rel=1e-5)
    loss.sum().backward()
    assert logits.grad is not None and torch.isfinite(logits.grad).all() and logits.grad[2] > 0 > logits.grad[3]


def test_a_batch_without_a_vehicle_has_a_finite_loss() -> None:
    target = assign_centres(WAYMO_GRID, WINDOW, torch.zeros(0, 7), torch.zeros(0, dtype=torch.bool), 1)
    parts = CentreObjective(Recipe(heads="centres")).loss(torch.full((1600,), 50.0), torch.zeros(0, 8), target)
    assert torch.isfinite(parts["class"]) and parts["box"] == 0.0


def test_only_peaks_are_reported() -> None:
    heads, window = CentreHeads(4), BevWindow(0, 0, 8, 6, 1, 1, 5, 4)
    logits = torch.zeros(4, 5)
    logits[1, 1], logits[1, 2], logits[3, 4] = 3.0, 2.0, 1.0
    peaks = heads.reported(logits.reshape(-1), window).view(4, 5)
    assert peaks[1, 1] and peaks[3, 4] and not peaks[1, 2] and not peaks[2, 2] and not peaks[0, 0]
