"""Weather on beams with two returns: a beam meets one particle, and reports it once."""

import numpy as np
import pytest
from analytic_fields import Frame

from shift3d.effects.chain import EffectChain
from shift3d.effects.physics.pairing import beam_numbers
from shift3d.scenes.facts import EffectSettings
from shift3d.scenes.street.assemble import street_scene
from shift3d.scenes.street.options import StreetOptions

WEATHER = {
    "snow": EffectSettings(snow_mm_h=2.5),
    "rain": EffectSettings(rain_mm_h=50.0),
    "fog": EffectSettings(visibility_m=50.0),
}


@pytest.fixture(scope="module")
def scene():
    return street_scene("test", 0, 0, "hdl64", StreetOptions(returns=2, sensor_model=True))


@pytest.mark.parametrize("name", WEATHER)
def test_a_later_return_lies_behind_the_first_of_its_beam(scene, name):
    count = len(scene.points)
    beam = beam_numbers(scene, count)
    first_of = np.full(count, -1)
    first_of[beam[scene.return_number == 0]] = np.flatnonzero(scene.return_number == 0)
    later = np.flatnonzero((scene.return_number == 1) & (first_of[beam] >= 0))
    first = first_of[beam[later]]
    chain = EffectChain.of([name], scene, Frame(), 5, WEATHER[name])
    background = chain._background
    range_m, returned = background.range_m.numpy(), background.returned.numpy()
    clear_m = chain.beams.ranges_m.numpy()
    assert len(later) > 1000
    assert int((returned & (range_m < clear_m - 0.5)).sum()) > 500  # particles or fog are there
    both = returned[later] & returned[first]
    assert both.sum() > 300
    noise_m = 0.1
    in_clear_air = clear_m[later] - clear_m[first]
    behind = range_m[later] - range_m[first]
    assert (behind[both] > np.minimum(in_clear_air[both], 0.0) - noise_m).all()
    assert not (returned[later] & (range_m[later] < clear_m[later] - 0.5)).any()
