"""The shipped detectors in foreign layouts give the same logits, boxes and gradient on a street."""

from __future__ import annotations

from math import pi
from pathlib import Path

import pytest
import torch
from foreign_ports import PORTS

from shift3d.detectors.foreign.detector import foreign_layout, load_foreign
from shift3d.detectors.loading import load_detector
from shift3d.scenes.sets import StreetScenes


@pytest.fixture(scope="module")
def points() -> torch.Tensor:
    scene = StreetScenes("hdl64", count=1, split="test").load("street-test-hdl64-000000")
    return torch.from_numpy(scene.points[scene.has_beam]) - torch.tensor([0.0, 0.0, scene.ground_z_m])


@pytest.mark.parametrize("name", PORTS)
def test_it_sees_what_the_shipped_one_sees(name: str, points: torch.Tensor, tmp_path: Path) -> None:
    port = PORTS[name]
    config, weights = port.saved(tmp_path)
    theirs = load_foreign(foreign_layout(port.codebase, config, port.choices), weights)
    shipped = load_detector(port.shipped)
    answers = []
    for detector in (shipped, theirs):
        moved = points.clone().requires_grad_()
        found = detector.proposals(moved, shipped.window_for((12.0, 3.0), 8.0))
        (gradient,) = torch.autograd.grad(found.logits.sigmoid().square().sum(), moved)
        answers.append((found, gradient))
    (ours, gradient), (found, same) = answers
    assert float(ours.logits.detach().sigmoid().max()) > 0.5 and float(gradient.abs().max()) > 1e-2
    torch.testing.assert_close(found.logits.sigmoid(), ours.logits.sigmoid(), rtol=0, atol=1e-5)
    torch.testing.assert_close(found.boxes[:, :6], ours.boxes[:, :6], rtol=0, atol=2e-5)
    turned = torch.remainder(found.boxes[:, 6] - ours.boxes[:, 6] + pi, 2 * pi) - pi
    seen = ours.logits.sigmoid() > 0.05  # elsewhere a heading's sine and cosine may both be near 0
    assert bool(seen.any()) and float(turned[seen].abs().max()) < 1e-4
    assert float((same - gradient).norm()) < 1e-5 * float(gradient.norm())
