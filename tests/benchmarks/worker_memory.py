"""A worker in its own process: runs tasks on the scene of a file and prints its peak memory as JSON."""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

import numpy as np
from benchmarks.world import SHORT, make_spec, open_assets, streets

from shift3d.scenes.scene import Labels, Scene
from shift3d.sweep.execution.worker import Worker
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.task.assets import Assets
from shift3d.task.exchange import AssetsSpec
from shift3d.task.run import run_task
from shift3d.task.spec import PlacementSpec


def peak_mb() -> float:
    """Return the peak resident memory of this process, in 10^6 bytes.

    The kernel's own count is preferred to getrusage, whose maximum survives exec, so that a child starts with its
    parent's memory.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def read_scene(path: Path) -> Scene:
    """Read the scene of a file with points (N, 3), ground_z_m and boxes (M, 7) of vehicles."""
    with np.load(path, allow_pickle=False) as file:
        points, boxes, ground_z_m = file["points"], file["boxes"], float(file["ground_z_m"])
    origins = np.broadcast_to(np.zeros((1, 3), dtype=np.float32), points.shape)
    labels = Labels(boxes, ("vehicle",) * len(boxes), np.ones(len(boxes), dtype=np.int32))
    return Scene("from-file", "street-mixed", points, origins, ground_z_m, labels)


def main(path: str, steps: str, tasks: str) -> None:
    """Run tasks, each at another place. Raises RuntimeError if a task returns no score, which voids its memory."""
    import dataclasses

    scene = read_scene(Path(path))
    scenes = streets()
    name = scenes.hold(scene)
    loaded: list[float] = []

    def load(_: AssetsSpec) -> Assets:
        assets = open_assets(scenes)
        loaded.append(peak_mb())
        return assets

    def nothing(_: object) -> None:
        raise NotImplementedError

    attack = dataclasses.replace(SHORT, steps=int(steps))
    spec = make_spec(name, attack=attack, placement=PlacementSpec())
    specs = [dataclasses.replace(spec, replicate=number) for number in range(int(tasks))]
    worker = Worker(TaskKind(run_task, load, nothing), "bench", [AssetsSpec(scenes={})])  # type: ignore[arg-type]
    scored = []
    for one in specs:
        outcome = worker.run_batch([PlannedTask(one, 0)])
        scores = outcome.tables["scores"].column("score").drop_null() if outcome.done else ()
        if not len(scores):
            raise RuntimeError(f"no score: {[table.to_pylist() for table in outcome.tables.values()]}")
        scored += scores.to_pylist()
    found = {"peak_mb": peak_mb(), "loaded_mb": loaded[0], "points": len(scene.points), "scores": len(scored)}
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
