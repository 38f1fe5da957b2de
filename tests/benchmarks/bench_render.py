"""The renderer against its plain reference, and the cost of a rendering by range and by hits."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from benchmarks.results import Results
from benchmarks.steps import cold_rendering
from benchmarks.timing import repeat, take_turns
from benchmarks.world import World

RANGES_M = (15, 20, 25, 30, 35, 40, 45, 50)


def bench_render_cold(bench: Results, world: World, quick: bool) -> None:
    standard = world.problem(world.counterpart_scene)
    paper = world.problem(world.counterpart_scene, accuracy="paper")
    grid = world.sdf_grid(standard)
    found = cold_rendering(standard, grid)  # this call is also the warm-up
    calls = {
        "mapped": (functools.partial(cold_rendering, standard, grid), 2 if quick else 10),
        "paper": (functools.partial(cold_rendering, paper), 1),
        "plain": (functools.partial(cold_rendering, standard), 2 if quick else 10),
    }
    times = take_turns(calls, rounds=1 if quick else 2)
    where = f"{len(standard.beams)} beams, vehicle at {world.range_m:.1f} m"
    note = f"{where}, {found.object_points} hits, {found.evaluations} evaluations"
    of = "one rendering, nothing to start from, no gradients, same beams: paper ms / standard ms"
    bench.ratio("render_cold_ratio", times["paper"], times["mapped"], f"{of} with the vehicle's SDF grid", note)
    bench.ratio("render_cold_without_map_ratio", times["paper"], times["plain"], f"{of} without an SDF grid", where)
    made = repeat(lambda: world.sdf_grid(standard), budget_s=0.0 if quick else 3.0, least=1)
    bench.time("empty_space_ms", made, "making the vehicle's SDF grid, once a task", f"{grid.evaluations} evaluations")


@pytest.fixture(scope="module")
def cold_by_range(bench: Results, world: World, quick: bool) -> list[tuple[int, float]]:
    """(hits, milliseconds) at every range that has a place for the vehicle; also adds their records."""
    found, grid = [], world.sdf_grid(world.problem())
    for range_m in RANGES_M[::4] if quick else RANGES_M:
        if (place := world.place_at(range_m)) is None:
            continue
        scene, placement = place
        problem = world.problem(scene, theta=placement.theta)
        timing = repeat(functools.partial(cold_rendering, problem, grid), budget_s=0.5 if quick else 4.0, least=2)
        hits, evaluations = placement.rendering.object_points, cold_rendering(problem, grid).evaluations
        of = f"one standard rendering with the vehicle's SDF grid, vehicle at {range_m} m"
        bench.time(f"render_cold_ms_at_{range_m}m", timing, of, f"{hits} hits, {evaluations} evaluations, {scene}")
        found.append((hits, timing.median))
    return found


def bench_render_range(cold_by_range: list[tuple[int, float]]) -> None:
    assert cold_by_range, "no range has a place for the vehicle"


def bench_render_hits(bench: Results, cold_by_range: list[tuple[int, float]]) -> None:
    if len({hits for hits, _ in cold_by_range}) < 2:
        pytest.skip("a slope needs two renderings")
    hits, times = np.array(cold_by_range).T
    slope, base = np.polyfit(hits, times, 1)
    note = f"{base:.0f} ms with no hit, by the same line; {hits.min():.0f} to {hits.max():.0f} hits"
    bench.add("render_cold_us_per_hit", 1e3 * slope, "us", "slope of milliseconds against hits over ranges", note=note)
