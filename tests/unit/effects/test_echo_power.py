"""The power of echoes and the losses that follow from it, against closed forms."""

import math

import numpy as np
import pytest
import torch
from analytic_fields import Frame

from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.physics.power import (
    DetectionLoss,
    detection_draws,
    detection_probability,
    echo_power,
    least_power,
    loss,
    overlap,
)
from shift3d.render.beams import Beams
from shift3d.scenes.scene import Scene
from shift3d.scenes.sensor import SensorModel
from shift3d.scenes.street.returns import HALF_POWER, POWER_SPREAD

COUNT = 40_000


def values(*numbers: float) -> torch.Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def context_of(sensor: SensorModel | None, seed: int = 3) -> EffectContext:
    points = np.random.default_rng(1).uniform(5.0, 50.0, (COUNT, 3)).astype(np.float32)
    scene = Scene("power", "made", points, np.zeros((COUNT, 3), np.float32), -1.7, sensor=sensor)
    return EffectContext(scene, Beams.from_scene(scene), Frame(), seed)


def returns_of(context: EffectContext, on_object: bool) -> Returns:
    beams, one = context.beams, torch.ones(COUNT, dtype=torch.float64)
    there, yes = torch.full((COUNT,), on_object), torch.ones(COUNT, dtype=torch.bool)
    points = beams.points.double()
    return Returns(torch.arange(COUNT), points, beams.origins, beams.directions, there, yes, one, one)


def test_overlap_rises_linearly_from_0_9_to_1_metre():
    near = overlap(values(0.0, 0.9, 0.925, 0.95, 1.0, 40.0))
    torch.testing.assert_close(near, values(0.0, 0.0, 0.25, 0.5, 1.0, 1.0), rtol=0, atol=1e-12)


def test_power_by_hand():
    # 0.5 * 0.8 / 20^2 = 1e-3; at 0.95 m half is visible, at 0 m nothing.
    power = echo_power(values(0.5, 0.5, 0.5), values(0.8, 0.8, 0.8), values(20.0, 0.95, 0.0))
    torch.testing.assert_close(power, values(1e-3, 0.5 * 0.4 / 0.95**2, 0.0))


def test_extinction_is_lost_on_both_ways():
    assert loss(0.01, 30.0) == pytest.approx(1.0 - math.exp(-0.6))


def test_the_limit_is_met_by_albedo_0_9_at_its_range():
    assert least_power(120.0) == pytest.approx(float(echo_power(values(0.9), values(1.0), values(120.0))))


def test_sharp_limit():
    sensor = SensorModel(limit_range_m=100.0)
    assert detection_probability(values(8.9e-5, 9.1e-5, 0.0), sensor).tolist() == [0.0, 1.0, 0.0]


def test_an_unknown_limit_loses_nothing():
    assert detection_probability(values(0.0, 1e-12, 1.0), SensorModel()).tolist() == [1.0, 1.0, 1.0]
    context = context_of(None)
    limit = DetectionLoss.of(context, "fog")
    assert not limit.lost(returns_of(context, True), torch.zeros(COUNT), torch.zeros(COUNT)).any()


def test_the_streets_lose_by_the_same_law():
    sensor = SensorModel(limit_range_m=math.sqrt(0.9 / HALF_POWER), power_spread=POWER_SPREAD)
    power = torch.logspace(-8, -2, 200, dtype=torch.float64)
    street = 1.0 / (1.0 + np.exp(-(np.log(power.numpy()) - np.log(HALF_POWER)) / POWER_SPREAD))
    np.testing.assert_allclose(detection_probability(power, sensor).numpy(), street, rtol=1e-12)
    assert float(detection_probability(values(HALF_POWER), sensor)) == pytest.approx(0.5)
    assert float(detection_probability(values(0.0), sensor)) == 0.0


def test_gradients_of_power_and_survival():
    sensor = SensorModel(limit_range_m=100.0, power_spread=0.5)
    inputs = [values(0.3, 0.6).requires_grad_(), values(0.4, 0.9).requires_grad_(), values(0.95, 40.0).requires_grad_()]
    assert torch.autograd.gradcheck(lambda a, c, r: detection_probability(echo_power(a, c, r), sensor), inputs)


@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_losses_on_the_object_and_on_the_scene(spread):
    """The share S(P T) of echoes on the object survives; of the returns known to exist, S(P T) / S(P)."""
    sensor = SensorModel(limit_range_m=100.0, power_spread=spread)
    context = context_of(sensor)
    power, transmission = torch.full((COUNT,), 1.5e-4, dtype=torch.float64), torch.full((COUNT,), 0.5).double()
    limit = DetectionLoss.of(context, "rain")
    before, after = (float(detection_probability(values(p), sensor)) for p in (1.5e-4, 0.75e-4))
    for on_object, expected in ((True, after), (False, after / before)):
        kept = 1.0 - float(limit.lost(returns_of(context, on_object), power, transmission).double().mean())
        assert abs(kept - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


@pytest.mark.parametrize("on_object", [True, False])
def test_two_losses_in_turn_are_one_by_both(on_object):
    sensor = SensorModel(limit_range_m=100.0, power_spread=0.4)
    context = context_of(sensor)
    power = torch.full((COUNT,), 2e-4, dtype=torch.float64)
    returns, first, second = returns_of(context, on_object), torch.full((COUNT,), 0.6), torch.full((COUNT,), 0.5)
    lost = DetectionLoss.of(context, "fog").lost(returns, power, first.double())
    lost |= DetectionLoss.of(context, "snow").lost(returns, power * first, second.double())
    expected = float(detection_probability(values(0.6e-4), sensor))
    if not on_object:
        expected /= float(detection_probability(values(2e-4), sensor))
    assert abs(float((~lost).double().mean()) - expected) < 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT)


def test_ray_drop_after_weather_loses_nobody_that_weather_had_to_keep():
    """There is one draw per beam: an echo that weather keeps is not lost by a second draw at the same power."""
    sensor = SensorModel(limit_range_m=100.0, power_spread=0.4)
    context = context_of(sensor)
    power, transmission = torch.full((COUNT,), 1e-4, dtype=torch.float64), torch.full((COUNT,), 0.7).double()
    lost = DetectionLoss.of(context, "rain").lost(returns_of(context, True), power, transmission)
    dropped = detection_draws(context) >= detection_probability(power * transmission, sensor)
    assert torch.equal(lost, dropped)


@pytest.mark.parametrize("spread", [0.0, 0.4])
@pytest.mark.parametrize("power", [0.0, 1e-6, 1.0])
def test_without_loss_of_power_the_scene_keeps_everything(spread, power):
    context = context_of(SensorModel(limit_range_m=100.0, power_spread=spread))
    one = torch.ones(COUNT, dtype=torch.float64)
    assert not DetectionLoss.of(context, "fog").lost(returns_of(context, False), power * one, one).any()


@pytest.mark.parametrize("power", [0.0, 1e-6])
@pytest.mark.parametrize(("spread", "exponent"), [(0.0, 1.0), (0.5, 2.0)])
def test_echoes_from_below_the_limit_fade_with_transmission(power, spread, exponent):
    context = context_of(SensorModel(limit_range_m=50.0, power_spread=spread))
    one = torch.ones(COUNT, dtype=torch.float64)
    lost = DetectionLoss.of(context, "fog").lost(returns_of(context, False), power * one, 0.8 * one)
    expected = 0.8**exponent
    allowed = 3.0 * math.sqrt(expected * (1.0 - expected) / COUNT) + 0.01 * (spread > 0.0)
    assert abs(float((~lost).double().mean()) - expected) < allowed
