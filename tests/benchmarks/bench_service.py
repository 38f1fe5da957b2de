"""Cost per task of the sweep service, compared with the alternatives of a user, and its scaling."""

from __future__ import annotations

import dataclasses
import statistics
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from benchmarks.results import Results
from benchmarks.service_cost import Parts, forecast, forecast_lines
from benchmarks.timed_sweep import in_own_process

GRID = ("vehicle=coupe", "mode=shape", "attack.lambda=1", "effects=none")
WEIGHTS = Path(__file__).resolve().parents[2] / "shift3d" / "weights"


def sweep(kind: str, name: str, workers: int, *overrides: str, folder: Path) -> dict[str, Any]:
    return in_own_process("benchmarks.timed_sweep", kind, name, str(workers), *overrides, folder=folder)


def bare(processes: int, name: str, *overrides: str, folder: Path) -> float:
    """Measure tasks per second of independent processes side by side, each with all the tasks."""
    with ThreadPoolExecutor(processes) as pool:
        found = list(pool.map(lambda _: sweep("REAL", name, 0, *overrides, folder=folder), range(processes)))
    return float(sum(one["tasks_a_second"] for one in found))


def other(name: str, jobs: int, folder: Path) -> dict[str, Any]:
    return in_own_process("benchmarks.other_services", name, str(jobs), folder=folder)


@pytest.fixture(scope="module")
def overhead_us(bench: Results, quick: bool, tmp_path_factory: pytest.TempPathFactory) -> float:
    """The service's time per no-op task, measured once for all benchmarks that refer to it."""
    count = 2_000 if quick else 100_000
    found = sweep("NOOP", "default", 2, *GRID, f"scenes.count={count}", folder=tmp_path_factory.mktemp("noop"))
    value = 1e6 * found["seconds"] / found["tasks"]
    of = "run phase of a sweep of no-op tasks with one score each, two Ray workers, durable commits; a task"
    note = f"{found['tasks']} tasks in {found['seconds']:.1f} s, {found['commits']} log entries"
    bench.add("sweep_overhead_us", value, "us", of, note=note)
    return value


def bench_overhead_beside_hydra(bench: Results, overhead_us: float, quick: bool, tmp_path: Path) -> None:
    basic = other("basic", 12 if quick else 100, tmp_path)
    bench.add("hydra_basic_job_ms", basic["ms"], "ms", "Hydra's own multirun in process, a no-op job")
    if find_spec("hydra_plugins.hydra_ray_launcher" if find_spec("hydra_plugins") else "hydra_plugins") is None:
        why = "hydra-ray-launcher is not installed (pip install --no-deps hydra-ray-launcher)"
        bench.add(
            "hydra_basic_ratio", 1e3 * basic["ms"] / overhead_us, "ratio", "hydra_basic_job_ms / overhead", note=why
        )
        return
    launcher = other("ray", 8 if quick else 50, tmp_path)
    bench.add("hydra_ray_launcher_job_ms", launcher["ms"], "ms", "Hydra's Ray launcher on two CPUs, a no-op job")
    of = "Hydra's Ray launcher, a no-op job / sweep_overhead_us"
    note = f"{launcher['ms']:.0f} ms / {overhead_us:.0f} us"
    bench.add("hydra_ray_launcher_ratio", 1e3 * launcher["ms"] / overhead_us, "ratio", of, note=note)


def bench_overhead_beside_ray_tune(bench: Results, overhead_us: float, quick: bool, tmp_path: Path) -> None:
    pytest.importorskip("ray.tune")
    tune = other("tune", 20 if quick else 300, tmp_path)
    of = "Ray Tune with two reused actors, a no-op trial / sweep_overhead_us"
    note = f"{tune['ms']:.1f} ms / {overhead_us:.0f} us"
    bench.add("ray_tune_ratio", 1e3 * tune["ms"] / overhead_us, "ratio", of, note=note)


@pytest.fixture(scope="module")
def task_s(bench: Results, quick: bool, tmp_path_factory: pytest.TempPathFactory) -> float:
    """Seconds per real task on one worker; also measures two workers beside one."""
    # The default sweep's tasks have 40 steps. The smoke sweep's have a few, so that a worker's first task, which loads
    # libraries and generates code, would weigh more than in any real sweep.
    name, turns, scenes = ("smoke", 1, 2) if quick else ("default", 3, 6)
    words = ("mode=shape,pose", "vehicle=coupe") if quick else ("vehicle=coupe,suv", "attack.lambda=1")
    found = in_own_process(
        "benchmarks.paired_workers", name, f"scenes.count={scenes}", *words, folder=tmp_path_factory.mktemp("paired")
    )
    of = f"work of two Ray workers / of one while the other is stopped; tasks of the {name} sweep, one thread each"
    note = f"a task takes {found['slower']:.3f} times as long, {found['pairs']} tasks of {found['seconds']:.1f} s"
    bench.add("scaling_two_workers", 2 / found["slower"], "ratio", of, note=note)
    rates: dict[int, list[float]] = {1: [], 2: []}
    alone: dict[int, list[float]] = {1: [], 2: []}
    words = ("scenes.count=2", *words)
    for turn in range(turns):
        # In turns, so that a machine that slows down affects both alike.
        for workers in (1, 2) if turn % 2 == 0 else (2, 1):
            found = sweep("REAL", name, workers, *words, folder=tmp_path_factory.mktemp("real"))
            rates[workers].append(found["tasks_a_second"])
            if turn == 0:
                alone[workers].append(bare(workers, name, *words, folder=tmp_path_factory.mktemp("bare")))
    of = f"tasks a second of two Ray workers while both work / of one, whole sweeps of {found['tasks']} of these tasks"
    _add_scaling(bench, "scaling_whole_sweeps", rates, of)
    of = "the same tasks in two processes without Ray, each on its own / in one: what this machine's cores allow"
    _add_scaling(bench, "scaling_two_processes", alone, of)
    return 1 / max(rates[1])


def _add_scaling(bench: Results, name: str, rates: dict[int, list[float]], of: str) -> None:
    """Add the median over turns of two workers beside one in the same turn: the machine drifts by a tenth."""
    ratios = [two / one for one, two in zip(rates[1], rates[2], strict=True)]
    turns = ", ".join(f"{two:.3g} / {one:.3g}" for one, two in zip(rates[1], rates[2], strict=True))
    bench.add(name, statistics.median(ratios), "ratio", of, note=f"{turns} a second; median of the turns")


def bench_cost_model(bench: Results, overhead_us: float, task_s: float, quick: bool, tmp_path: Path) -> None:
    calls, commits = (200, 5) if quick else (5_000, 50)
    found = in_own_process("benchmarks.service_parts", str(calls), str(commits), folder=tmp_path)
    weights_mb = sum((WEIGHTS / f"{name}.safetensors").stat().st_size for name in ("pointpillars", "sdf")) / 1e6
    parts = Parts(overhead_us=overhead_us, weights_mb=weights_mb, task_s=task_s, **found)
    bench.add("service_commit_ms", parts.commit_ms, "ms", "a durable commit of 1,000 score rows, local disk")
    bench.add("service_call_us", parts.call_us, "us", "a call to a Ray actor and its answer, two actors in turns")
    bench.add("service_transfer_mb_s", parts.transfer_mb_s, "MB/s", "64 MB into the object store and an actor")
    bench.add("service_task_s", task_s, "s", "a real task, one worker: see scaling_whole_sweeps")
    thousand = forecast(parts, workers=1_000, tasks=10**7)
    of = "extrapolated: the shortest task at which one driver keeps 1,000 workers busy"
    note = forecast_lines(thousand).replace("\n", "; ")
    bench.add("service_shortest_task_s_at_1000", thousand.shortest_task_s, "s", of, note=note)
    longer = forecast(dataclasses.replace(parts, task_s=30.0), workers=1_000, tasks=10**7)
    busy = 100 * sum(longer.busy.values())
    of = "extrapolated: share of the driver's time with 1,000 workers on tasks of 30 s (the paper's steps)"
    bench.add("service_driver_busy_percent", busy, "%", of, note=f"first bottleneck: {longer.bottleneck}")
