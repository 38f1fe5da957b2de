"""Two Ray workers beside one on the same tasks in the same minutes; prints both times as JSON.

A machine's speed drifts by a tenth within minutes, so that a sweep with one worker and then one with two would compare
two machines. In this benchmark the measured worker does every task twice, once while the other worker is stopped
(SIGSTOP) and once beside it, in an order that changes from task to task.
"""

from __future__ import annotations

import json
import os
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import noop_task

from shift3d.settings.compose import compose_sweep
from shift3d.sweep.drive import run_sweep
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.results.final import FinalTables
from shift3d.task.exchange import AssetsSpec, TaskResult
from shift3d.task.run import run_task
from shift3d.task.spec import TaskSpec

__all__ = ["PAIRED", "paired"]

_done = 0  # tasks finished by this worker


def load(spec: AssetsSpec) -> Any:
    """Load the real task's assets. The first worker that has them is the measured one."""
    assets = noop_task.load_real(spec)
    try:
        with (_folder() / "measured").open("x") as file:
            file.write(str(os.getpid()))
    except FileExistsError:
        pass
    return assets


def run(spec: TaskSpec, assets: Any) -> TaskResult:
    global _done
    _done += 1
    if (_folder() / "measured").read_text() != str(os.getpid()):
        return run_task(spec, assets)
    others = (int(mark.name) for mark in _folder().iterdir() if mark.name.isdigit())
    other = next((pid for pid in others if pid != os.getpid()), None)
    if other is None or _done == 1:  # a worker's first task loads libraries
        return run_task(spec, assets)
    order = ("alone", "beside") if _done % 2 else ("beside", "alone")
    found: dict[str, Any] = {"first": order[0]}
    for way in order:
        os.kill(other, signal.SIGSTOP if way == "alone" else signal.SIGCONT)
        try:
            used, began = _cpu_s(other), time.perf_counter()
            result = run_task(spec, assets)
            seconds = time.perf_counter() - began
            found[way] = (seconds, (_cpu_s(other) - used) / seconds)
        finally:
            os.kill(other, signal.SIGCONT)
    with (_folder() / "pairs").open("a") as file:
        file.write(json.dumps(found) + "\n")
    return result


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process's main thread (Linux)."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


def _folder() -> Path:
    return Path(os.environ["SHIFT3D_BENCH_MARKS"])


PAIRED = TaskKind(run=run, load=load, catalogue=noop_task.read_catalogue)


def paired(sweep: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Run a sweep with two workers.

    Returns:
        {"slower", "pairs", "seconds"}: factor by which a task takes longer beside another worker than alone, the
        geometric mean over tasks of each order and then over both orders, since a repeated task is a little faster;
        number of tasks compared; mean seconds of a task alone. Tasks near the sweep's end are left out if the other
        worker was idle for more than a tenth of the time.

    Raises:
        statistics.StatisticsError: no task of one order is left.
    """
    words = [*overrides, "runner.workers=2", "tracking=none"]
    plan, config = make_plan(compose_sweep(sweep, words), PAIRED.catalogue)
    with tempfile.TemporaryDirectory(prefix="shift3d-bench-", dir=Path.cwd()) as folder:
        marks = Path(folder) / "marks"
        marks.mkdir()
        os.environ["SHIFT3D_BENCH_MARKS"] = str(marks)
        run_sweep(plan, config.runner, PAIRED, Path(folder) / "out", lambda *_: FinalTables({}))
        found = [json.loads(line) for line in (marks / "pairs").read_text().splitlines()]
    pairs = [pair for pair in found if pair["alone"][1] < 0.01 and pair["beside"][1] > 0.9]
    of_orders = [
        statistics.geometric_mean(pair["beside"][0] / pair["alone"][0] for pair in pairs if pair["first"] == first)
        for first in ("alone", "beside")
    ]
    return {
        "slower": statistics.geometric_mean(of_orders),
        "pairs": len(pairs),
        "seconds": statistics.mean(pair["alone"][0] for pair in pairs),
    }


if __name__ == "__main__":
    print(json.dumps(paired(sys.argv[1], sys.argv[2:])))
