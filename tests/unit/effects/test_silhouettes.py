"""Selection of cones to test, against casting every sub-ray of every beam."""

import math

import numpy as np
import pytest
import torch
from analytic_fields import Frame, car, in_frame, rounded

from shift3d.effects.base import Insertion
from shift3d.effects.chain import EffectChain
from shift3d.effects.divergence import PULSE_M, SUB_RAY_SHARE
from shift3d.effects.physics.silhouettes import silhouette_rows, sub_rays
from shift3d.render import Beams, SdfGrid, preset, render
from shift3d.scenes.facts import EffectSettings
from shift3d.scenes.scene import Scene

EXACT = preset("reference").with_(step_m=0.02)
ANGLE = 0.003


def scene_about_a_car(seed: int) -> Scene:
    """Return beams from the origin all over a car at 18 m, at a wall twice as far."""
    rng, count = np.random.default_rng(seed), 1500
    places = np.stack((np.full(count, 18.0), rng.uniform(-1, 5, count), rng.uniform(-2, 0.2, count)), 1)
    origins = np.broadcast_to(np.zeros((1, 3), np.float32), places.shape)
    return Scene("car", "made", (2.0 * places).astype(np.float32), origins, -1.7)


@pytest.mark.parametrize("yaw", [0.3, -2.0])
def test_no_beam_is_overlooked_whose_sub_rays_disagree(yaw: float) -> None:
    theta = torch.tensor([18.0, 2.0, -0.9, yaw, 0.02, -0.03], dtype=torch.float64)
    frame = Frame(scale_m=2.5)
    field = in_frame(car(), frame)
    scene = scene_about_a_car(6)
    beams, angle = Beams.of_main_sensor(scene), SUB_RAY_SHARE * ANGLE / 2
    plain = render(beams, field, theta, frame, EXACT)
    chosen = torch.zeros(len(beams), dtype=torch.bool)
    chosen[silhouette_rows(Insertion(beams, plain, field, theta, frame, EXACT), angle)] = True
    outer = sub_rays(beams.directions, angle).reshape(-1, 3)
    ends = beams.ranges_m.repeat_interleave(6)
    cast = Beams.from_arrays(ends[:, None] * outer, torch.zeros(3))
    found = render(cast, field, theta, frame, EXACT)
    # An edge may be off by a twentieth of the cone's radius: closer misses do not count.
    nearly = render(cast, in_frame(rounded(car(), 0.001), frame), theta, frame, EXACT).hit_mask.reshape(-1, 6)
    hits = torch.cat((plain.hit_mask[:, None], found.hit_mask.reshape(-1, 6)), 1)
    ranges = torch.cat((plain.range_m[:, None], found.range_m.reshape(-1, 6)), 1)
    edge = hits.any(1) & ~(plain.hit_mask & nearly.all(1))
    step = hits.all(1) & (ranges.sort(1).values.diff(dim=1) > PULSE_M).any(1)
    assert int(edge.sum()) > 20
    assert bool(chosen[edge | step].all())
    assert int(chosen.sum()) < 0.5 * int(hits.any(1).sum())


def test_an_sdf_grid_changes_nothing_but_the_time() -> None:
    theta, frame = torch.tensor([18.0, 2.0, -0.9, 0.3, 0.02, -0.03], dtype=torch.float64), Frame(scale_m=2.5)
    field = in_frame(car(), frame)
    scene = scene_about_a_car(7)
    settings = preset("standard").with_(dtype=torch.float64)
    chain = EffectChain.of(["divergence"], scene, frame, 1, EffectSettings(divergence_rad=ANGLE))
    space = SdfGrid.of(field, frame, settings)
    plain, mapped = (chain.render(field, theta, settings, None, given) for given in (None, space))
    assert plain.core is not None and not torch.equal(plain.hit_mask, plain.core.hit_mask)
    assert torch.equal(plain.hit_mask, mapped.hit_mask)
    assert torch.allclose(plain.range_m, mapped.range_m, rtol=0.0, atol=1e-4)


def test_sub_rays_are_unit_vectors_at_the_angle_and_balance_each_other() -> None:
    rng = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(200, 3, generator=rng, dtype=torch.float64), dim=-1)
    directions = torch.cat((directions, torch.eye(3, dtype=torch.float64), -torch.eye(3, dtype=torch.float64)))
    rays = sub_rays(directions, 0.002)
    assert torch.allclose(rays.norm(dim=-1), torch.ones(len(rays), 6, dtype=torch.float64), rtol=0, atol=1e-14)
    assert torch.allclose((rays * directions[:, None]).sum(-1), torch.full((1,), math.cos(0.002), dtype=torch.float64))
    assert torch.allclose(rays.mean(1), math.cos(0.002) * directions, rtol=0, atol=1e-14)
