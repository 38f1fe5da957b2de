"""The architecture's lines for one attack step by hand run as printed, and their gradients are those it promises."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from shift3d.render import Beams, preset, render
from shift3d.vehicles.sources import VehicleSet

PAGE = Path(__file__).parents[3] / "docs" / "architecture.md"


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    found: dict[str, Any] = {}
    before, folder = Path.cwd(), tmp_path_factory.mktemp("from_python")
    os.chdir(folder)
    try:
        exec(compile(block, PAGE.name, "exec"), found)
    finally:
        os.chdir(before)
    assert (folder / "scene.png").is_file()
    return found


def test_the_lines_take_one_step(names: dict[str, Any]) -> None:
    rendering, beams = names["rendering"], names["beams"]
    hit = rendering.hit_mask
    assert torch.allclose(names["depth_m"], rendering.range_m[hit], atol=1e-5)
    assert not rendering.range_m.requires_grad and not names["proposals"].boxes.requires_grad
    assert names["loss_by_code"].shape == names["code0"].shape and names["loss_by_pose"].shape == (6,)
    assert float(names["loss_by_code"].norm()) > 0.0 and float(names["depth_by_pose"].norm()) > 0.0
    assert np.isfinite(names["image_m"]).sum() == len(beams)
    assert names["result"].trace[0].loss == pytest.approx(float(names["loss"].detach()), rel=1e-4)


def test_the_gradient_of_every_beam_is_that_of_finite_differences(names: dict[str, Any]) -> None:
    scene, vehicle, decoder = names["scene"], names["vehicle"], VehicleSet().decoder().double()
    beams = Beams.from_arrays(scene.points.astype(np.float64), scene.origins[0])
    settings = preset("reference").with_(min_n_dot_d=0.0)
    code0, theta0 = names["code0"].double(), names["theta0"]
    along = [torch.from_numpy(np.random.default_rng(0).standard_normal(len(start))) for start in (code0, theta0)]

    def depth(step: Tensor) -> tuple[Tensor, Tensor]:
        code, theta = (start + step * way / way.norm() for start, way in zip((code0, theta0), along))
        rendering = render(beams, decoder.field(code), theta, vehicle, settings)
        return ((rendering.points - beams.origins) * beams.directions).sum(1), rendering.hit_mask

    half = 1e-6
    at = torch.zeros((), dtype=torch.float64, requires_grad=True)
    depth_m, hit = depth(at)
    (high, also_high), (low, also_low) = (depth(torch.tensor(sign * half, dtype=torch.float64)) for sign in (1.0, -1.0))
    beam = (hit & also_high & also_low).nonzero().squeeze(1)[::25]
    by_gradient = torch.stack([torch.autograd.grad(depth_m[i], at, retain_graph=True)[0] for i in beam])
    by_difference = ((high - low) / (2.0 * half))[beam].detach()
    assert len(beam) > 15
    assert torch.allclose(by_gradient, by_difference, rtol=1e-3, atol=1e-6)
