"""A step of the attack, against the published method and against the best that the processor could do."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from benchmarks.arithmetic import counted, detector_pass, evaluation_flops, gradient_flops
from benchmarks.results import Results
from benchmarks.steps import AttackLoops, cold_rendering, published_step
from benchmarks.timing import Timing
from benchmarks.world import World


@pytest.fixture(scope="module")
def published(world: World, loops: AttackLoops) -> dict[str, Timing]:
    """Times of the published step's stages. Attacks run before and after it: both include the machine's drift."""
    stages = published_step(world.problem(world.counterpart_scene, accuracy="paper"))
    loops.run()
    return {stage: Timing.of([value]) for stage, value in stages.items()}


def bench_warm_render(bench: Results, loops: AttackLoops, published: dict[str, Timing]) -> None:
    of = "rendering inside an attack from its second step on, gradients included: paper ms / standard ms"
    for mode, loop in loops.loops.items():
        note = f"{loop.evaluations:.0f} evaluations, {loop.hits:.0f} hits"
        bench.ratio(f"render_warm_{mode}_ratio", published["render"], loop.render, f"{of}, {mode} attack", note)
    slower = loops.slowest(lambda loop: loop.render)
    below = loops.loops[slower].render
    bench.ratio("render_warm_ratio", published["render"], below, f"{of}, the slower of shape and pose", slower)


def bench_attack_step(bench: Results, loops: AttackLoops, published: dict[str, Timing]) -> None:
    of = "one attack step: (paper renderer, whole scene, float32) ms / standard ms"
    for mode, loop in loops.loops.items():
        name = f"attack_step_{mode}_ratio"
        bench.ratio(name, published["total"], loop.step, f"{of}, {mode} attack", loop.stages())
    slower = loops.slowest(lambda loop: loop.step)
    split = ", ".join(f"{stage} {timing.median:.0f}" for stage, timing in published.items() if stage != "total")
    note = f"{slower}; published way: {split} ms"
    below = loops.loops[slower].step
    bench.ratio("attack_step_ratio", published["total"], below, f"{of}, the slower of shape and pose", note)


@dataclass(frozen=True)
class Work:
    """Operations that a step must compute, and the most operations per second.

    forward, gradient: of one point in the decoder. detector: of its window, forward and backward.
    """

    forward: float
    gradient: float
    detector: float
    peak_gflops: float
    detector_peak_gflops: float

    def limit_ms(self, evaluations: float, hits: float) -> float:
        """Return the least possible time of a step."""
        decoder = evaluations * self.forward + hits * self.gradient
        return 1e-6 * (decoder / self.peak_gflops + self.detector / self.detector_peak_gflops)

    def sum(self, evaluations: float, hits: float) -> str:
        """Return the same time as a sum in words, for a note."""
        return (
            f"({evaluations:.0f} evaluations x {1e-6 * self.forward:.2f} + {hits:.0f} hits x "
            f"{1e-6 * self.gradient:.2f} MFLOP) / {self.peak_gflops:.0f} GFLOP/s + detector "
            f"{1e-9 * self.detector:.1f} GFLOP / {self.detector_peak_gflops:.0f} GFLOP/s"
        )


@pytest.fixture(scope="module")
def work(loops: AttackLoops, peak_gflops: dict[torch.dtype, float]) -> Work:
    """Work of a step, counted and measured on the problem of the attacks."""
    problem = loops.problem
    rendering = cold_rendering(problem)
    peak = peak_gflops[torch.float32]
    precision = getattr(torch, problem.detector.precision)  # type: ignore[attr-defined]
    detector_peak = peak_gflops.get(precision, peak)
    detector = counted(detector_pass(problem, rendering))
    return Work(evaluation_flops(problem), gradient_flops(problem), detector, peak, detector_peak)


@pytest.mark.parametrize("least", [False, True], ids=["made", "least"])
def bench_limit(bench: Results, loops: AttackLoops, work: Work, least: bool) -> None:
    """Add the limit records. The limit leaves out the evaluations that a step's constraints need."""
    found = {}
    for mode, loop in loops.loops.items():
        evaluations = loop.hits if least else loop.evaluations
        limit_ms = work.limit_ms(evaluations, loop.hits)
        note = f"{mode}: {loop.step.median:.0f} ms / {limit_ms:.0f} ms = {work.sum(evaluations, loop.hits)}"
        found[mode] = (loop.step.median / limit_ms, loop.step.low / limit_ms, loop.step.high / limit_ms, note)
    value, low, high, _ = max(found.values())
    name, what = ("limit_least_ratio", "one evaluation a hit") if least else ("limit_ratio", "evaluations made")
    of = f"attack step / (({what}, gradients at the hits, the detector's window) / measured peak), the slower mode"
    bench.add(name, value, "ratio", of, low, high, "; ".join(note for *_, note in found.values()))
