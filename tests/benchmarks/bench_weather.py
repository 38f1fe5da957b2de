"""Cost of weather over a whole scene."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from analytic_fields import Frame
from benchmarks.results import Results
from benchmarks.timing import milliseconds, repeat

from shift3d.effects.applicability import effect_named
from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.weather.fog import fog_echo_table
from shift3d.effects.weather.precipitation import crossings
from shift3d.render.beams import Beams
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import SensorModel

POINTS = 180_000
WEATHER = {
    "fog": Conditions("fog", visibility_m=60.0, weather_in_points=False),
    "rain": Conditions("rain", rain_mm_h=10.0, weather_in_points=False),
    "snow": Conditions("snow", snow_mm_h=1.0, weather_in_points=False),
}


def scene_in(conditions: Conditions) -> tuple[EffectContext, Returns]:
    """Make beams in all directions, 2 to 100 m long, of a sensor of the streets."""
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = (rng.uniform(2.0, 100.0, (POINTS, 1)) * directions).astype(np.float32)
    reflectance = rng.uniform(0.0, 1.0, POINTS).astype(np.float32)
    origins = np.broadcast_to(np.zeros(3, np.float32), (POINTS, 3))
    sensor = SensorModel(limit_range_m=640.0, power_spread=0.45)
    scene = Scene(
        "weather", "made", points, origins, -1.7, reflectance=reflectance, conditions=conditions, sensor=sensor
    )
    beams = Beams.from_scene(scene)
    no, yes = torch.zeros(POINTS, dtype=torch.bool), torch.ones(POINTS, dtype=torch.bool)
    albedo, one = torch.from_numpy(reflectance).double(), torch.ones(POINTS, dtype=torch.float64)
    rows = torch.arange(POINTS)
    returns = Returns(rows, beams.points.double(), beams.origins, beams.directions, no, yes, one, albedo, albedo)
    return EffectContext(scene, beams, Frame(), seed=1), returns


@pytest.mark.parametrize("name", WEATHER)
def bench_weather(bench: Results, name: str, quick: bool) -> None:
    """Time binding (draws for every beam) and the step, one thread; a process's first call also makes the table."""
    context, returns = scene_in(WEATHER[name])
    effect = effect_named(name)

    def whole() -> Returns:
        return effect.bind(context)(returns)  # type: ignore[arg-type, return-value]

    fog_echo_table.cache_clear()
    crossings.cache_clear()
    first_ms = milliseconds(whole)
    timing = repeat(whole, budget_s=0.5 if quick else 3.0)
    note = f"{first_ms:.0f} ms the first time, with the table"
    bench.time(f"{name}_180k_ms", timing, f"{name} over a scene of {POINTS} points, bind and step", note)
