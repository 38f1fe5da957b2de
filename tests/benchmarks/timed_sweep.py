"""A sweep in its own process, with durable commits; prints the time of its run phase as JSON.

The run phase begins when the first worker has loaded its assets and ends with the last commit: it excludes planning,
Ray's start and the final tables. Each sweep has its own process, because Ray and its settings belong to a process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

__all__ = ["in_own_process", "run_phase"]


def run_phase(kind_name: str, sweep: str, workers: int, overrides: Sequence[str]) -> dict[str, Any]:
    """Run a sweep of ``benchmarks.noop_task``'s kinds. workers: Ray's; 0: in this process, without Ray.

    Returns:
        {"seconds", "tasks", "commits", "tasks_a_second"}. The last is the sum over workers of its tasks by the time
        from its first task's start to its last task's end: it excludes a sweep's end, when some workers are idle.
    """
    from benchmarks import noop_task

    from shift3d.settings.compose import compose_sweep
    from shift3d.store.location import Location
    from shift3d.store.log_entries import Commit
    from shift3d.sweep.drive import run_sweep
    from shift3d.sweep.planning.plan import Plan, make_plan
    from shift3d.sweep.results.final import FinalTables, segments_in_plan_order

    kind = getattr(noop_task, kind_name)
    runner = [f"runner.workers={workers}"] if workers else ["runner=local"]
    words = [*overrides, *runner, "tracking=none"]
    plan, config = make_plan(compose_sweep(sweep, words), kind.catalogue)
    ended: list[tuple[float, int, float]] = []

    def finish(folder: Location, plan: Plan, entries: Sequence[Commit]) -> FinalTables:
        now = time.time()
        tries = segments_in_plan_order(folder, entries, "attempts", plan).to_pandas()
        tries = tries.assign(end=tries["started_unix_s"] + tries["seconds"]).groupby("worker")
        busy = tries["end"].max() - tries["started_unix_s"].min()
        ended.append((now, len(entries), float((tries.size() / busy).sum())))
        return FinalTables({})

    with tempfile.TemporaryDirectory(prefix="shift3d-bench-", dir=Path.cwd()) as folder:
        marks = Path(folder) / "marks"
        marks.mkdir()
        os.environ["SHIFT3D_BENCH_MARKS"] = str(marks)
        result = run_sweep(plan, config.runner, kind, Path(folder) / "out", finish)
        began = min(float(mark.read_text()) for mark in marks.iterdir())
    if result.done != result.planned:
        raise RuntimeError(f"{result.done} of {result.planned} tasks done")
    return {"seconds": ended[0][0] - began, "tasks": result.done, "commits": ended[0][1], "tasks_a_second": ended[0][2]}


def in_own_process(module: str, *words: str, folder: Path) -> dict[str, Any]:
    """Run ``python -m MODULE WORDS`` in a folder and read the JSON of its last line.

    Raises:
        RuntimeError: the command failed; the message holds the end of its output.
    """
    tests = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join([tests, str(Path(tests).parent), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", module, *words]
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr[-3000:]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    kind_, sweep_, workers_, *overrides_ = sys.argv[1:]
    print(json.dumps(run_phase(kind_, sweep_, int(workers_), overrides_)))
