"""Memory of a worker on a large scene."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from benchmarks.results import Results
from benchmarks.world import densified, streets

POINTS = 180_000


def bench_worker_peak(bench: Results, tmp_path: Path, quick: bool) -> None:
    # The scene comes from a file, like recorded frames: making a street takes memory of its own.
    scenes = streets()
    scene = densified(scenes.load(scenes.names()[1]), POINTS)
    file = tmp_path / "scene.npz"
    np.savez(file, points=scene.points, ground_z_m=scene.ground_z_m, boxes=scene.labels.of_class("vehicle"))
    command = [sys.executable, "-m", "benchmarks.worker_memory", str(file), *(("1", "1") if quick else ("40", "8"))]
    tests = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["points"] == POINTS
    tasks = "one shape task of a step" if quick else "8 shape tasks of 40 steps"
    of = f"peak resident memory of a process with a worker in {tasks}, standard, {POINTS} points"
    note = f"{found['loaded_mb']:.0f} MB before the task; {found['scores']} objects scored"
    bench.add("worker_peak_mb", found["peak_mb"], "MB", of, note=note)
