"""The service's plan at its largest: a million tasks, and a resumption with nearly all of them done."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.results import Results

SCENES, QUICK_SCENES = 50_000, 1_000
A_SCENE = 20  # tasks: five vehicles, four lambda


def run(what: str, folder: Path, scenes: int) -> tuple[float, dict[str, Any]]:
    """Return the seconds of a whole process, imports included, and its printed results with ``cpu_s``."""
    tests = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", "benchmarks.million_tasks", what, str(folder), str(scenes)]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, {**json.loads(done.stdout.splitlines()[-1]), "cpu_s": cpu_s}


def bench_million_tasks(bench: Results, tmp_path: Path, quick: bool) -> None:
    scenes, folder = QUICK_SCENES if quick else SCENES, tmp_path / "out"
    setting = "of 10^6 tasks (5 vehicles, 4 lambda, 50,000 scenes known by name), one core, imports included"
    seconds, planned = run("plan", folder, scenes)
    assert planned["tasks"] == A_SCENE * scenes
    megabytes = (folder / "plan.parquet").stat().st_size / 1e6
    note = f"{planned['cpu_s']:.1f} s of it computing; plan.parquet has {megabytes:.1f} MB"
    of = f"a plan {setting}: composed, expanded, identified and written"
    bench.add("plan_million_s", seconds, "s", of, note=note)
    bench.add("plan_million_peak_mb", planned["peak_mb"], "MB", f"peak resident memory of planning, {setting}")
    run("finish", folder, scenes)
    for what, name, of in (
        ("resume", "resume_million_s", f"the same command when 99 % are done, {setting}: planned again, log read"),
        ("read", "reread_million_s", f"plan.parquet and log of a folder when 99 % are done, {setting}: ids checked"),
    ):
        seconds, found = run(what, folder, scenes)
        assert found["left"] <= 0.01 * found["tasks"] + 5_000
        note = f"{found['cpu_s']:.1f} s of it computing; {found['left']} tasks left, peak {found['peak_mb']:.0f} MB"
        bench.add(name, seconds, "s", of, note=note)
