"""Rendering against closed forms and invariances, both renderers."""

import math

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Frame, box, car, ground_scan, in_frame, sector_scan, sphere
from torch import Tensor

from shift3d.errors import InputError
from shift3d.geometry.se3 import object_from_scene, scene_from_object, scene_R_object
from shift3d.render import Beams, RenderSettings, preset, render

EXACT = preset("reference").with_(step_m=0.02)
PAPER = preset("paper").with_(dtype=torch.float64)
BOTH = pytest.mark.parametrize("settings", [EXACT, PAPER], ids=["fast", "paper"])
THETA = torch.tensor([14.0, 3.0, -0.95, 0.6, 0.03, -0.05], dtype=torch.float64)


def fan(theta: Tensor = THETA, rays: int = 24) -> Beams:
    x, y, z = (float(v) for v in theta[:3])
    return Beams.from_arrays(*sector_scan((x, y, z), half_angle_rad=0.2, rays=rays))


@BOTH
def test_depth_on_a_sphere(settings: RenderSettings) -> None:
    beams, radius = fan(), 1.0
    rendering = render(beams, in_frame(sphere(radius), SHAPENET_FRAME), THETA, SHAPENET_FRAME, settings)
    along = beams.directions @ THETA[:3]
    discriminant = along**2 - THETA[:3].square().sum() + radius**2
    expected = discriminant > 0
    # The paper's step may miss a chord shorter than itself.
    clear = (2 * discriminant.clamp_min(0).sqrt() > 0.1) | ~expected
    assert torch.equal(rendering.hit_mask[clear], expected[clear])
    hit = rendering.hit_mask
    depth = (along - discriminant.clamp_min(0).sqrt())[hit]
    assert float((rendering.range_m[hit] - depth).abs().max()) < 2e-7
    assert rendering.object_points > 20 and rendering.unresolved_beams == 0


@BOTH
def test_depth_on_a_box_through_pose_and_scale_by_hand(settings: RenderSettings) -> None:
    # A 4 x 2 x 1 m box at x = 10, turned by 90 degrees: its long side faces the sensor at x = 10 - 1.
    frame = Frame((4.0, 2.0, 1.0), SHAPENET_FRAME.scale_m, SHAPENET_FRAME.sdf_R_object, SHAPENET_FRAME.sdf_t_object)
    theta = torch.tensor([10.0, 0.0, 0.0, math.pi / 2, 0.0, 0.0], dtype=torch.float64)
    # Seen below the edge of the front face: y in [-2, 2], z in [-0.5, 0.5] at x = 9.
    targets = np.array([[9.0, 1.98, 0.0], [9.0, -1.98, 0.48], [9.0, 2.05, 0.0], [9.0, 0.0, 0.55]])
    beams = Beams.from_arrays(targets * 3.0, np.zeros(3))
    rendering = render(beams, in_frame(box((2.0, 1.0, 0.5)), frame), theta, frame, settings)
    assert rendering.hit_mask.tolist() == [True, True, False, False]
    assert np.allclose(rendering.points[:2].numpy(), targets[:2], atol=1e-6)


def test_what_is_not_hit_stays_bit_for_bit_and_in_order() -> None:
    points, origin = ground_scan()
    beams = Beams.from_arrays(points, origin)
    rendering = render(beams, in_frame(car(), SHAPENET_FRAME), THETA, SHAPENET_FRAME)
    assert rendering.points.dtype == torch.float32
    untouched = ~rendering.hit_mask
    assert torch.equal(rendering.points[untouched], torch.from_numpy(points)[untouched])
    assert rendering.object_points > 200
    # Returns move towards the sensor along their own beam.
    moved = rendering.points[rendering.hit_mask].double()
    assert (rendering.range_m[rendering.hit_mask] < beams.ranges_m[rendering.hit_mask]).all()
    cosine = (moved / moved.norm(dim=-1, keepdim=True) * beams.directions[rendering.hit_mask]).sum(-1)
    assert float((1 - cosine).max()) < 1e-12


@BOTH
def test_hits_lie_on_the_surface(settings: RenderSettings) -> None:
    rendering = render(fan(), in_frame(car(), SHAPENET_FRAME), THETA, SHAPENET_FRAME, settings)
    hits = object_from_scene(rendering.points[rendering.hit_mask], THETA)
    assert float(car()(hits).abs().max()) < 1e-6
    assert rendering.max_residual_m < 1e-6


def test_a_return_in_front_stays_and_one_inside_moves_out() -> None:
    centre = THETA[:3].numpy()
    direction = centre / np.linalg.norm(centre)
    points = np.stack([direction * 5.0, centre, direction * 40.0])
    rendering = render(
        Beams.from_arrays(points, np.zeros(3)), in_frame(sphere(1.0), SHAPENET_FRAME), THETA, SHAPENET_FRAME, EXACT
    )
    assert rendering.hit_mask.tolist() == [False, True, True]
    assert np.allclose(rendering.points[1].numpy(), direction * (np.linalg.norm(centre) - 1.0), atol=1e-6)


def test_permuting_and_splitting_the_beams_changes_nothing() -> None:
    points, origin = sector_scan((14.0, 3.0, -0.95), rays=30)
    field = in_frame(car(), SHAPENET_FRAME)
    whole = render(Beams.from_arrays(points, origin), field, THETA, SHAPENET_FRAME, EXACT)
    order = np.random.default_rng(0).permutation(len(points))
    permuted = render(Beams.from_arrays(points[order], origin), field, THETA, SHAPENET_FRAME, EXACT)
    assert torch.allclose(permuted.points, whole.points[order], atol=1e-12)
    halves = [
        render(Beams.from_arrays(p, origin), field, THETA, SHAPENET_FRAME, EXACT) for p in (points[:450], points[450:])
    ]
    assert torch.allclose(torch.cat([h.points for h in halves]), whole.points, atol=1e-12)


@BOTH
def test_moving_scene_and_object_together_moves_the_result(settings: RenderSettings) -> None:
    motion = torch.tensor([120.0, -40.0, 7.0, 1.3, 0.0, 0.0], dtype=torch.float64)
    points, origin = sector_scan((14.0, 3.0, -0.95), rays=20)
    there = scene_from_object(torch.from_numpy(points), motion).numpy()
    there_origin = scene_from_object(torch.from_numpy(origin[None]), motion).numpy()[0]
    theta = torch.cat((scene_from_object(THETA[None, :3], motion)[0], THETA[3:]))
    theta[3] += motion[3]
    field = in_frame(car(), SHAPENET_FRAME)
    assert torch.allclose(scene_R_object(theta), scene_R_object(motion) @ scene_R_object(THETA))
    here = render(Beams.from_arrays(points, origin), field, THETA, SHAPENET_FRAME, settings)
    away = render(Beams.from_arrays(there, there_origin), field, theta, SHAPENET_FRAME, settings)
    assert torch.equal(here.hit_mask, away.hit_mask)
    assert torch.allclose(scene_from_object(here.points, motion), away.points, atol=1e-6)


def test_every_beam_starts_at_its_own_sensor() -> None:
    # One return, seen by two sensors: only the beam of the first passes the sphere.
    points = np.array([[20.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    origins = np.array([[0.0, 0.0, 0.0], [0.0, 30.0, 0.0]])
    theta = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    rendering = render(
        Beams.from_arrays(points, origins), in_frame(sphere(1.0), SHAPENET_FRAME), theta, SHAPENET_FRAME, EXACT
    )
    assert rendering.hit_mask.tolist() == [True, False]


@pytest.mark.parametrize("bad", [torch.zeros(5), torch.tensor([1.0, 2, torch.nan, 0, 0, 0])])
def test_a_bad_pose_is_refused(bad: Tensor) -> None:
    with pytest.raises(InputError, match="pose"):
        render(fan(), in_frame(car(), SHAPENET_FRAME), bad, SHAPENET_FRAME)


def test_unknown_presets_and_settings_are_refused() -> None:
    with pytest.raises(InputError, match="preset"):
        preset("fast")
    with pytest.raises(InputError, match="step_m"):
        RenderSettings(step_m=0.0)
