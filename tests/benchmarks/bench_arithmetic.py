"""Share of the processor's peak that decoder and detector reach."""

from __future__ import annotations

import torch
from benchmarks.arithmetic import counted, decoder_pass, detector_pass
from benchmarks.results import Results
from benchmarks.steps import cold_rendering
from benchmarks.timing import repeat
from benchmarks.world import World


def bench_gemm_peak(peak_gflops: dict[torch.dtype, float]) -> None:
    assert all(peak > 0 for peak in peak_gflops.values())


def bench_decoder(bench: Results, world: World, peak_gflops: dict[torch.dtype, float], quick: bool) -> None:
    problem = world.problem()
    batch, dtype = problem.settings.batch, problem.settings.dtype
    forward = decoder_pass(problem, batch)
    flops, timing = counted(forward), repeat(forward, budget_s=1.0 if quick else 5.0)
    gflops = 1e-6 * flops / timing.median
    of = f"shipped decoder forward, {batch} points at once, {str(dtype).removeprefix('torch.')}"
    note = f"{1e-6 * flops / batch:.3g} MFLOP an evaluation, {timing.median:.0f} ms"
    bench.add("decoder_gflops", gflops, "GFLOP/s", of, 1e-6 * flops / timing.high, 1e-6 * flops / timing.low, note)
    bench.add("decoder_peak_fraction", gflops / peak_gflops[dtype], "of peak", f"{of}, over the measured peak")


def bench_detector(bench: Results, world: World, peak_gflops: dict[torch.dtype, float], quick: bool) -> None:
    problem = world.problem()
    rendering = cold_rendering(problem)
    step = detector_pass(problem, rendering)
    flops, timing = counted(step), repeat(step, budget_s=2.0 if quick else 10.0, least=2)
    gflops = 1e-6 * flops / timing.median
    precision = problem.detector.precision  # type: ignore[attr-defined]
    of = f"PointPillars in the attack's window, forward and back to the points, {precision}"
    note = f"{1e-9 * flops:.1f} GFLOP, {timing.median:.0f} ms"
    bench.add("detector_gflops", gflops, "GFLOP/s", of, 1e-6 * flops / timing.high, 1e-6 * flops / timing.low, note)
    peak = peak_gflops.get(getattr(torch, precision), peak_gflops[torch.float32])
    bench.add("detector_peak_fraction", gflops / peak, "of peak", f"{of}, over the measured peak")
