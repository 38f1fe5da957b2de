"""Time that each effect adds to a rendering: one object in one street, with and without an effect, in turns."""

from __future__ import annotations

import time
from dataclasses import replace

from benchmarks.results import Results
from benchmarks.timing import Timing

from shift3d.effects.applicability import NEEDS
from shift3d.placement.sampling import NoPlacement
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.task.assets import load_assets
from shift3d.task.exchange import AssetsSpec
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.spec import TaskSpec

# The scene set of sweeps/effects.yaml.
STREET = {"kind": "street", "sensor": "hdl64", "split": "test", "seed": 0, "count": 1, "sensor_model": True}
STREET |= {"range_image": True, "returns": 2, "ego_speed_m_s": 15.0, "motion_compensated": True}
STATED = {"visibility_m": 50.0, "rain_mm_h": 50.0, "snow_mm_h": 2.5, "object_speed_m_s": 10.0}


def bench_effects(bench: Results, quick: bool) -> None:
    assets = load_assets(AssetsSpec(scenes=STREET))
    accuracy = accuracy_settings(AccuracyConfig(name="standard", render={}))
    (name,) = assets.scenes.names()
    plain = TaskSpec("suv", name, "street", "shape", 1.0, 0.01, "pointpillars", "standard", accuracy_settings=accuracy)
    placement = place_vehicle(plain, assets)
    assert not isinstance(placement, NoPlacement)
    problems = {"": build_problem(plain, assets, placement.theta)}
    for effect in NEEDS:
        spec = replace(plain, effects=(effect,), effect_settings=STATED)
        problems[effect] = build_problem(spec, assets, placement.theta)
    spent: dict[str, list[float]] = {effect: [] for effect in problems}
    hits = 0
    for turn in range(2 if quick else 14):
        for effect, problem in problems.items():
            start = time.perf_counter()
            rendering = problem.insert(problem.code0, placement.theta)
            if turn:  # the first round fills the caches
                spent[effect].append(1e3 * (time.perf_counter() - start))
            hits = rendering.object_points if not effect else hits
    alone = Timing.of(spent[""])
    bench.add("rendering_without_effects_ms", alone.median, "ms", f"a cold rendering with an SDF grid, {hits} hits")
    for effect in NEEDS:
        more = Timing.of([ours - none for ours, none in zip(spent[effect], spent[""], strict=True)])
        of = f"a rendering with {effect} over the same without"
        bench.add(f"effect_{effect}_ms", more.median, "ms", of, more.low, more.high)
