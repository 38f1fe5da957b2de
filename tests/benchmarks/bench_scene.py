"""Cost of beams that pass far from the object."""

from __future__ import annotations

import functools

import pytest
from benchmarks.results import Results
from benchmarks.steps import AttackLoops, cold_rendering
from benchmarks.timing import Timing, milliseconds
from benchmarks.world import World, with_beams_elsewhere

from shift3d.attack.problem import AttackProblem
from shift3d.render import SdfGrid

ELSEWHERE = "the scene's beams and so many times as many, none of the new ones within 12 m of the object"


class Sized:
    """The attack in a scene of one size, with its times."""

    def __init__(self, problem: AttackProblem, steps: int) -> None:
        self.attacks = AttackLoops(problem, steps, modes=("shape",))
        self.cold_ms: list[float] = []

    def measure(self, grid: SdfGrid, renderings: int) -> None:
        """Time one more attack and more cold renderings."""
        self.attacks.run()
        cold = functools.partial(cold_rendering, self.attacks.problem, grid)
        self.cold_ms += [milliseconds(cold) for _ in range(renderings)]

    def timings(self) -> dict[str, Timing]:
        """Return the times by their names."""
        loop = self.attacks.loops["shape"]
        return {"attack_step": loop.step, "render_warm": loop.render, "render_cold": Timing.of(self.cold_ms)}


@pytest.fixture(scope="module")
def by_size(world: World, quick: bool) -> dict[int, Sized]:
    """Times of every scene size, measured in turns."""
    sized = {}
    scene = world.scenes.load(world.scene)
    for factor in (1, 8) if quick else (1, 2, 4, 8):
        name = world.scenes.hold(with_beams_elsewhere(scene, world.theta, factor))
        sized[factor] = Sized(world.problem(name), steps=3 if quick else 5)
    grid = world.sdf_grid(sized[1].attacks.problem)
    for turn in range(1 if quick else 2):
        for factor in list(sized)[:: 1 if turn % 2 == 0 else -1]:
            sized[factor].measure(grid, renderings=1 if quick else 3)
    return sized


def bench_scene_growth(bench: Results, by_size: dict[int, Sized]) -> None:
    timings = {factor: sized.timings() for factor, sized in by_size.items()}
    for factor, by_what in timings.items():
        attacks = by_size[factor].attacks
        beams = f"{len(attacks.problem.beams)} beams"
        for what, timing in by_what.items():
            note = f"{beams}; {attacks.loops['shape'].stages()}" if what == "attack_step" else beams
            bench.time(f"{what}_ms_at_{factor}x_beams", timing, f"{what.replace('_', ' ')}, {ELSEWHERE}", note)
    names = {"attack_step": "scene_growth_ratio"}
    for what, most in timings[max(timings)].items():
        name = names.get(what, f"scene_growth_{what}_ratio")
        bench.ratio(name, most, timings[1][what], f"{what.replace('_', ' ')} with 8 times the beams / with 1")
