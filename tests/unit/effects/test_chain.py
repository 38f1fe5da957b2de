"""Properties of every chain of effects: rows, gradients, the background, and quantities that no effect changes."""

import dataclasses

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, car, ground_scan, in_frame, soft_car
from torch import Tensor

from shift3d.effects.applicability import NEEDS
from shift3d.effects.chain import NO_RETURN_M, EffectChain
from shift3d.errors import InputError
from shift3d.render import Beams, preset, render
from shift3d.render.rendering import Rendering
from shift3d.scenes.facts import EffectSettings
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import NoReturnBeams

FRAME = SHAPENET_FRAME
CAR = in_frame(car(), FRAME)
THETA = torch.tensor([14.0, 3.0, -0.95, 0.6, 0.03, -0.05], dtype=torch.float64)
SETTINGS = preset("standard").with_(dtype=torch.float64)
NOTHING = EffectSettings()


def scene_of(no_return: bool = False, sensors: int = 1, rings: int = 32, columns: int = 900) -> Scene:
    """Return a scan of flat ground and a wall. no_return: every fourth return from beyond 30 m is removed."""
    points, place = ground_scan(rings, columns)
    origins = np.broadcast_to(place[None], points.shape)
    if sensors == 2:
        origins = origins.copy()
        origins[::2, 1] += 0.5
    times = np.linspace(0.0, 0.1, len(points)).astype(np.float32)
    quiet = None
    if no_return:
        lost = np.zeros(len(points), bool)
        lost[::4] = np.linalg.norm(points[::4], axis=1) > 30.0
        directions = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)[lost]
        quiet = NoReturnBeams(np.zeros_like(directions), directions, times[lost])
        points, origins, times = points[~lost], origins[~lost], times[~lost]
    scene = Scene("ring", "made", points, origins, -1.73, time_s=times, no_return=quiet)
    scene.validate()
    return scene


def chain_of(names: list[str], scene: Scene, settings: EffectSettings = NOTHING) -> EffectChain:
    return EffectChain.of(names, scene, FRAME, 5, settings)


def same(first: Rendering, second: Rendering) -> bool:
    return all(torch.equal(getattr(first, n), getattr(second, n)) for n in ("points", "hit_mask", "range_m"))


def test_an_empty_chain_is_the_plain_rendering_bit_for_bit_gradients_included() -> None:
    scene = scene_of(sensors=2)
    gradients: list[tuple[Tensor, ...]] = []
    renderings = []
    for chained in (False, True):
        code = torch.zeros(6, dtype=torch.float64, requires_grad=True)
        pose, field = THETA.clone().requires_grad_(), in_frame(soft_car(code), FRAME)
        if chained:
            rendering = chain_of([], scene).render(field, pose, SETTINGS)
        else:
            rendering = render(Beams.of_main_sensor(scene), field, pose, FRAME, SETTINGS)
        gradients.append(torch.autograd.grad(rendering.points.double().square().sum(), (pose, code)))
        renderings.append(rendering)
    assert same(*renderings) and renderings[0].object_points > 100
    assert renderings[1].returned is None and not renderings[1].milliseconds
    assert all(torch.equal(a, b) for a, b in zip(*gradients, strict=True))


def test_cast_effects_that_add_nothing_are_the_plain_rendering_of_their_beams() -> None:
    scene = scene_of(sensors=2)
    chain = chain_of(["origins"], scene)
    assert same(chain.render(CAR, THETA, SETTINGS), render(Beams.from_scene(scene), CAR, THETA, FRAME, SETTINGS))


def test_effects_act_in_the_order_of_the_physics_whatever_order_they_are_named_in() -> None:
    scene, names = scene_of(no_return=True, sensors=2), ["divergence", "rolling_shutter", "origins", "no_return_beams"]
    settings = EffectSettings(divergence_rad=0.003, object_speed_m_s=10.0)
    chain, other = chain_of(names, scene, settings), chain_of(sorted(names), scene, settings)
    assert chain.names == other.names == tuple(name for name in NEEDS if name in names)
    first, second = chain.render(CAR, THETA, SETTINGS), other.render(CAR, THETA, SETTINGS)
    assert same(first, second) and set(first.milliseconds) == {"divergence"}


@pytest.mark.parametrize(
    "names", [["no_return_beams"], ["origins", "no_return_beams", "rolling_shutter", "divergence"]]
)
def test_rows_never_change_number_or_order(names: list[str]) -> None:
    scene = scene_of(no_return=True, sensors=2)
    assert scene.no_return is not None
    settings = EffectSettings(divergence_rad=0.003, object_speed_m_s=10.0)
    chain, count = chain_of(names, scene, settings), len(scene.points)
    places = torch.cat((torch.from_numpy(scene.points), torch.zeros(len(scene.no_return), 3)))
    met = []
    for x in (12.0, 25.0, -300.0):
        theta = THETA.clone()
        theta[0] = x
        rendering = chain.render(CAR, theta, SETTINGS)
        assert rendering.points.shape == places.shape and rendering.returned is not None
        kept = ~rendering.hit_mask
        assert torch.equal(rendering.points[:count][kept[:count]], places[:count][kept[:count]])
        out = kept[count:]
        assert bool((rendering.points[count:][out].norm(dim=-1) > 0.99 * NO_RETURN_M).all())
        assert torch.equal(rendering.returned[count:], ~out) and bool(rendering.returned[:count].all())
        met.append(int((~out).sum()))
    assert met[0] > met[1] > 0 and met[2] == 0


def test_what_has_no_return_rests_far_out_along_its_beam() -> None:
    scene = scene_of(no_return=True)
    # A sensor that detects nothing beyond some metres.
    chain = chain_of(["no_return_beams", "ray_drop"], scene, EffectSettings(limit_range_m=3.0))
    rendering = chain.render(CAR, THETA, SETTINGS)
    assert rendering.core is not None and rendering.returned is not None
    hit = rendering.core.hit_mask
    assert rendering.object_points == 0 and int(hit.sum()) > 100
    assert torch.equal(rendering.returned, ~(hit | (torch.arange(len(hit)) >= len(scene.points))))
    lost = ~rendering.returned
    along = (rendering.points[lost].double() * chain.beams.directions[lost]).sum(-1)
    assert torch.allclose(along, torch.full_like(along, NO_RETURN_M), rtol=1e-6)
    assert torch.allclose(rendering.points[lost].double(), along[:, None] * chain.beams.directions[lost], atol=1e-2)
    assert bool((rendering.range_m[lost] == NO_RETURN_M).all())
    assert torch.equal(
        rendering.points[~lost], torch.cat((torch.from_numpy(scene.points),))[~lost[: len(scene.points)]]
    )


def test_gradients_flow_through_what_stays_on_the_object() -> None:
    """A shift along the beam and another beam origin do not change the derivative of a hit."""
    scene = dataclasses.replace(scene_of(), time_s=None)
    field = in_frame(soft_car(torch.zeros(6, dtype=torch.float64)), FRAME)
    pose = THETA.clone().requires_grad_()
    plain = render(Beams.of_main_sensor(scene), field, pose, FRAME, SETTINGS)
    settings = EffectSettings(range_noise_m=0.02, divergence_rad=1e-7)
    chain = chain_of(["range_noise", "divergence"], scene, settings)
    noisy = chain.render(field, pose, SETTINGS)
    assert torch.equal(plain.hit_mask, noisy.hit_mask) and not torch.equal(plain.points, noisy.points)
    weight = torch.randn(plain.points.shape, generator=torch.Generator().manual_seed(0)).double()
    (expected,) = torch.autograd.grad((plain.points.double() * weight).sum(), pose)
    (found,) = torch.autograd.grad((noisy.points.double() * weight).sum(), pose)
    assert torch.allclose(found, expected, rtol=1e-4) and bool((expected != 0).all())


def test_gradients_of_a_moving_object_are_those_of_the_displaced_pose() -> None:
    scene = scene_of()
    field = in_frame(soft_car(torch.zeros(6, dtype=torch.float64)), FRAME)
    chain = EffectChain.of(["rolling_shutter"], scene, FRAME, 5, EffectSettings(object_speed_m_s=20.0), 0.6)
    pose = THETA.clone().requires_grad_()
    rendering = chain.render(field, pose, SETTINGS)
    row = int(rendering.hit_mask.nonzero()[40])
    (found,) = torch.autograd.grad(rendering.points[row].double().sum(), pose)
    shift = chain.cast.shift_m
    assert shift is not None and float(shift[row].norm()) > 0.5
    there = THETA.clone()
    there[:3] += shift[row]
    there.requires_grad_()
    alone = Beams.from_arrays(scene.points[row : row + 1], np.zeros(3))
    (expected,) = torch.autograd.grad(render(alone, field, there, FRAME, SETTINGS).points.double().sum(), there)
    assert torch.allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_weather_of_a_recording_changes_the_objects_points_alone_once_its_rate_is_given() -> None:
    scene = dataclasses.replace(scene_of(), reflectance=np.full(len(scene_of().points), 0.3, np.float32),
                                conditions=Conditions(weather="rain"))  # fmt: skip
    settings = EffectSettings(rain_mm_h=50.0, limit_range_m=70.0)
    plain = chain_of([], scene, settings).render(CAR, THETA, SETTINGS)
    found = chain_of(["rain"], scene, settings).render(CAR, THETA, SETTINGS)
    changed = (found.points != torch.from_numpy(scene.points)).any(-1)
    assert bool(changed.any()) and not bool((changed & ~plain.hit_mask).any())
    with pytest.raises(InputError, match=f"scene {scene.scene_id}.*Leave out visibility_m"):
        chain_of(["rain"], scene, EffectSettings(rain_mm_h=50.0, visibility_m=60.0))


def test_weather_is_laid_over_the_scene_once_and_the_objects_rows_replace_it() -> None:
    scene = dataclasses.replace(scene_of(), reflectance=np.full(len(scene_of().points), 0.3, np.float32))
    settings = EffectSettings(visibility_m=60.0, limit_range_m=70.0)
    chain = chain_of(["fog"], scene, settings)
    away = THETA.clone()
    away[0] = -300.0
    background = chain.render(CAR, away, SETTINGS)
    assert background.object_points == 0 and background.returned is not None
    changed = (background.points != torch.from_numpy(scene.points)).any(-1)
    assert 0.05 < float(changed.double().mean()) < 1.0
    for x in (10.0, 14.0):
        theta = THETA.clone()
        theta[0] = x
        rendering = chain.render(CAR, theta, SETTINGS)
        assert rendering.core is not None and rendering.returned is not None
        touched = rendering.core.hit_mask
        # Beams past the object have the same returns, drops and echoes as without it, whatever object is inserted.
        for name in ("points", "range_m", "returned"):
            assert torch.equal(getattr(rendering, name)[~touched], getattr(background, name)[~touched])
        # Beams that meet the object return from it, or from fog before it, or not at all: never from behind.
        assert bool(rendering.hit_mask.any()) and not bool((rendering.hit_mask & ~touched).any())
        behind = (rendering.points == background.points).all(-1) & background.returned & rendering.returned
        before = background.range_m < rendering.core.range_m
        assert not bool((behind & touched & ~before).any())
        assert bool((rendering.hit_mask & ~background.returned).any())


def test_the_scene_itself_is_never_written_to() -> None:
    scene = scene_of(no_return=True, sensors=2)
    before = scene.content_hash()
    settings = EffectSettings(divergence_rad=0.003, object_speed_m_s=10.0, visibility_m=60.0, limit_range_m=70.0)
    names = ["origins", "no_return_beams", "rolling_shutter", "divergence", "fog", "ray_drop"]
    chain_of(names, scene, settings).render(CAR, THETA, SETTINGS)
    assert scene.content_hash() == before


def test_an_unknown_effect_is_refused() -> None:
    with pytest.raises(InputError, match=r"unknown effect 'fogg'.*fog"):
        chain_of(["origins", "fogg"], scene_of())
