"""Beams without a return: their ends, and the surfaces that they meet."""

import dataclasses

import numpy as np
import pytest
import torch
from analytic_fields import Frame, in_frame, sphere

from shift3d.effects.applicability import NEEDS
from shift3d.effects.base import Cast, EffectContext
from shift3d.effects.chain import NO_RETURN_M, EffectChain
from shift3d.effects.no_return_beams import EFFECT
from shift3d.render import Beams, preset
from shift3d.scenes.facts import DetectorFacts, EffectSettings, SceneFacts
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import NoReturnBeams

FRAME = Frame(size_m=(2.0, 2.0, 2.0), scale_m=2.5)
FIELD = in_frame(sphere(1.0), FRAME)
THETA = torch.tensor([20.0, 0.0, 0.0, 0.4, 0.0, 0.0], dtype=torch.float64)
SETTINGS = preset("reference").with_(step_m=0.02)
NOTHING = EffectSettings()


def no_return_of(count: int, place: tuple[float, float, float], times: bool = False) -> NoReturnBeams:
    rng = np.random.default_rng(4)
    aim = np.stack((np.full(count, 20.0), rng.uniform(-2, 2, count), rng.uniform(-2, 2, count)), 1) - place
    directions = (aim / np.linalg.norm(aim, axis=1, keepdims=True)).astype(np.float32)
    origins = np.broadcast_to(np.array([place], np.float32), (count, 3))
    return NoReturnBeams(origins, directions, np.full(count, 0.1, np.float32) if times else None)


def scene_of(place: tuple[float, float, float] = (0.0, 0.0, 0.0), second: bool = False, no_return: int = 60) -> Scene:
    rng = np.random.default_rng(3)
    points = np.stack((np.full(80, 40.0), rng.uniform(-4, 4, 80), rng.uniform(-4, 4, 80)), 1).astype(np.float32)
    origins = np.repeat(np.array([place], np.float32), 80, 0)
    if second:
        origins[1::2] += np.array([0.0, 1.0, 0.0], np.float32)
    times = np.linspace(0.0, 0.1, 80).astype(np.float32)
    return Scene(
        "sky", "made", points, origins, -1.7, time_s=times, no_return=no_return_of(no_return, place, times=True)
    )


def sphere_depths(beams: Beams, centre: torch.Tensor) -> torch.Tensor:
    """Return (N,) range of a unit sphere at centre (3,), or (N, 3); infinite if the beam misses it."""
    to_centre = centre - beams.origins
    along = (beams.directions * to_centre).sum(-1)
    discriminant = along**2 - to_centre.square().sum(-1) + 1.0
    return torch.where(discriminant > 0, along - discriminant.clamp_min(0).sqrt(), torch.inf)


def test_they_return_where_they_meet_the_object_and_rest_far_out_elsewhere() -> None:
    scene = scene_of()
    chain = EffectChain.of(["no_return_beams"], scene, FRAME, 1, NOTHING)
    rendering = chain.render(FIELD, THETA, SETTINGS)
    beams, depth = chain.beams, sphere_depths(chain.beams, THETA[:3])
    met = torch.isfinite(depth)
    assert torch.equal(rendering.hit_mask, met)
    assert 5 < int(met[80:].sum()) < 55 and bool(met[:80].any())
    assert rendering.returned is not None
    assert bool(rendering.returned[:80].all()) and torch.equal(rendering.returned[80:], met[80:])
    assert torch.allclose(rendering.range_m[met], depth[met], rtol=0.0, atol=1e-8)
    out = ~met
    out[:80] = False
    far = (rendering.points[out].double() - beams.origins[out]) / NO_RETURN_M
    assert torch.allclose(far, beams.directions[out], rtol=0.0, atol=1e-6)
    assert bool((rendering.range_m[out] == NO_RETURN_M).all())


def test_rows_of_the_scene_stay_bit_for_bit_and_no_return_rows_follow_in_their_order() -> None:
    scene = scene_of()
    before = Cast(Beams.of_main_sensor(scene))
    after = EFFECT.bind(EffectContext(scene, before.beams, FRAME, 1))(before)
    assert scene.no_return is not None and len(after.beams) == 80 + 60
    for name in ("points", "origins", "directions", "ranges_m", "carries"):
        assert torch.equal(getattr(after.beams, name)[:80], getattr(before.beams, name))
    assert torch.allclose(after.beams.directions[80:], torch.from_numpy(scene.no_return.directions).double(), atol=1e-6)
    assert torch.allclose(after.beams.directions[80:].norm(dim=-1), torch.ones(60, dtype=torch.float64), atol=1e-15)
    assert after.no_return is not None and torch.equal(after.no_return, torch.arange(140) >= 80)


@pytest.mark.parametrize("no_returns", [None, no_return_of(0, (0.0, 0.0, 0.0))])
def test_no_beams_without_a_return_is_the_identity_bit_for_bit(no_returns: NoReturnBeams | None) -> None:
    scene = dataclasses.replace(scene_of(), no_return=no_returns)
    cast = Cast(Beams.of_main_sensor(scene))
    assert EFFECT.bind(EffectContext(scene, cast.beams, FRAME, 1))(cast) is cast


def test_they_start_in_their_own_places_where_the_points_do() -> None:
    alone = EffectChain.of(["no_return_beams"], scene_of((0.5, 0.25, 0.0)), FRAME, 1, NOTHING)
    assert bool((alone.beams.origins == torch.tensor([0.5, 0.25, 0.0])).all())
    both = EffectChain.of(["no_return_beams", "origins"], scene_of((0.5, 0.25, 0.0), second=True), FRAME, 1, NOTHING)
    assert bool((both.beams.origins[80:] == torch.tensor([0.5, 0.25, 0.0])).all())
    assert len(both.beams.origins[:80].unique(dim=0)) == 2


def test_they_start_where_the_main_sensor_does_where_the_points_do() -> None:
    chain = EffectChain.of(["no_return_beams"], scene_of((0.5, 0.25, 0.0), second=True), FRAME, 1, NOTHING)
    assert bool((chain.beams.origins == 0.0).all())


def test_origins_no_return_rows_and_shutter_each_keep_what_the_former_did() -> None:
    scene = dataclasses.replace(scene_of((0.5, 0.25, 0.0), second=True), conditions=Conditions())
    settings = EffectSettings(object_speed_m_s=10.0)
    former = EffectChain.of(["origins", "no_return_beams"], scene, FRAME, 1, settings)
    chain = EffectChain.of(["rolling_shutter", "no_return_beams", "origins"], scene, FRAME, 1, settings)
    rendering, shift = chain.render(FIELD, THETA, SETTINGS), chain.cast.shift_m
    assert shift is not None and chain.cast.no_return is not None and int(chain.cast.no_return.sum()) == 60
    assert torch.allclose(chain.beams.origins + shift, former.beams.origins, rtol=0.0, atol=1e-14)
    assert torch.equal(chain.beams.directions, former.beams.directions)
    # No-return beams fire at 0.1 s, when the object is a metre farther on.
    depth = sphere_depths(former.beams, THETA[:3] + shift)
    assert float(shift[80:, 0].min()) == pytest.approx(1.0, abs=1e-6)
    assert torch.equal(rendering.hit_mask, torch.isfinite(depth)) and bool(rendering.hit_mask[80:].any())
    hit = rendering.hit_mask
    assert torch.allclose(rendering.range_m[hit], depth[hit], rtol=0.0, atol=1e-8)
    resting = former.beams.origins[80:] + NO_RETURN_M * former.beams.directions[80:]
    assert torch.allclose(rendering.points[80:][~hit[80:]].double(), resting[~hit[80:]], rtol=1e-7)


def test_applies_by_how_many_there_are() -> None:
    detector = DetectorFacts("any")
    reason = EFFECT.applicability(SceneFacts.of(scene_of()), detector)
    assert reason is not None and "60" in reason
    assert not NEEDS["no_return_beams"].present(SceneFacts.of(scene_of(no_return=0)))
