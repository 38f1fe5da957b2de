"""Every detector memorises one crop: its losses fall, and it then finds the crop's objects."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from random_networks import SLIM

from shift3d.detectors.base import BevWindow
from shift3d.detectors.models.sst import SstSpec
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.geometry.iou import iou_bev
from shift3d.training.detector.crops import Crop
from shift3d.training.detector.objective import batch_loss, objective_of
from shift3d.training.detector.recipe import Recipe

WINDOW = BevWindow(214, 214, 40, 40, 214, 214, 40, 40)
BOXES = np.array([[1.0, 0.5, 0.8, 4.5, 1.8, 1.6, 0.5], [-2.5, -3.8, 0.7, 4.2, 1.7, 1.4, 2.6]], dtype=np.float32)
RECIPES = {name: Recipe(network=spec, heads="centres" if name == "centerpoint" else "anchors")
           for name, spec in SLIM.items()}  # fmt: skip


def _crop() -> Crop:
    rng = np.random.default_rng(0)
    clouds = [rng.uniform((-6, -6, 0), (6, 6, 0.02), (2500, 3))]
    for box in BOXES:
        local = rng.uniform(-0.5, 0.5, (300, 3)) * box[3:6]
        cos, sin = np.cos(box[6]), np.sin(box[6])
        local[:, :2] = local[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        clouds.append(local + box[:3])
    return Crop(np.concatenate(clouds).astype(np.float32), BOXES, np.array([True, True]), WINDOW)


@pytest.mark.parametrize("name", RECIPES)
def test_logits_and_boxes_have_the_precision_of_the_weights_under_autocast(name: str) -> None:
    recipe = dataclasses.replace(RECIPES[name])
    net, crop, objective = recipe.new_network().eval(), _crop(), objective_of(recipe)
    target = objective.targets(net.heads, net.grid, crop)
    with torch.no_grad():
        features = net.features([torch.from_numpy(crop.points)], [WINDOW]).bfloat16()
        _, exact = batch_loss(objective, net.heads, features.float(), [target])
        with torch.autocast("cpu", torch.bfloat16):
            _, mixed = batch_loss(objective, net.heads, features, [target])
    assert mixed == exact


@pytest.mark.parametrize("name", RECIPES)
def test_a_memorised_crop_is_found(name: str) -> None:
    torch.manual_seed(0)
    recipe = dataclasses.replace(RECIPES[name], box_beta=1.0 / 9.0)
    net, crop, objective = recipe.new_network().train(), _crop(), objective_of(recipe)
    points, target = torch.from_numpy(crop.points), objective.targets(net.heads, net.grid, crop)
    rate = 4e-3 if isinstance(recipe.network, SstSpec) else 1e-2
    optimiser = torch.optim.AdamW(net.parameters(), lr=rate)
    curve: list[dict[str, float]] = []
    for _ in range(120):
        loss, parts = batch_loss(objective, net.heads, net.features([points], [WINDOW]), [target])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        curve.append(parts)
    for part in ("class", "box"):
        assert np.mean([step[part] for step in curve[-5:]]) < 0.25 * np.mean([step[part] for step in curve[:3]]), part
    # As in training: with the statistics of this crop.
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            module.momentum = 1.0
    net.features([points], [WINDOW])
    found = TrainedDetector(net.eval()).detect(points, WINDOW, score_threshold=0.3)
    assert len(found.boxes) >= 2
    overlap = iou_bev(found.boxes[:2], BOXES)
    assert sorted(overlap.argmax(axis=1).tolist()) == [0, 1] and overlap.max(axis=1).min() > 0.6
