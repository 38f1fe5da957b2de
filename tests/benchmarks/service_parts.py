"""Parts of the cost model of a cluster, measured one by one; printed as JSON."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from benchmarks.noop_task import _ROW

from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.store.log import CommitLog
from shift3d.store.schemas import SCHEMAS
from shift3d.sweep.execution.ray.connection import connect

ROWS, MEGABYTES = 1000, 64


def commit_ms(times: int) -> float:
    """Measure the median time of a durable commit of 1,000 score rows in the working directory's file system."""
    import pyarrow as pa

    defaults = {pa.string(): "x", pa.bool_(): True}
    row = {field.name: _ROW.get(field.name, defaults.get(field.type, 1)) for field in SCHEMAS["scores"]}
    lists = {field.name: ["x"] for field in SCHEMAS["scores"] if pa.types.is_list(field.type)}
    table = pa.Table.from_pylist([row | lists] * ROWS, schema=SCHEMAS["scores"])
    done = tuple(f"{index:032x}" for index in range(ROWS))
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        log = CommitLog(Path(folder), "0" * 16)
        taken = []
        for _ in range(times):
            began = time.perf_counter()
            log.commit(done, (), {"scores": table})
            taken.append(time.perf_counter() - began)
    return 1e3 * float(np.median(taken))


class _Nothing:
    def call(self, positions: np.ndarray, attempt: int) -> int:
        return len(positions)

    def take(self, weights: np.ndarray) -> int:
        return int(weights[-1])


def ray_parts(calls: int) -> dict[str, float]:
    """Time a call with two actors, one call in flight each, and weights into the object store and an actor."""
    runner = validate(compose_sweep("smoke", ["runner.workers=2"]).base, "benchmark").runner
    assert isinstance(runner, RayRunnerConfig)
    ray = connect(runner, 2)
    actors = [ray.remote(_Nothing).remote() for _ in range(2)]
    positions = np.arange(8)
    ray.get([actor.call.remote(positions, 1) for actor in actors])
    began = time.perf_counter()
    flying = {actor.call.remote(positions, 1): actor for actor in actors}
    for _ in range(calls):
        (ready,), _ = ray.wait(list(flying), num_returns=1)
        ray.get(ready)
        actor = flying.pop(ready)
        flying[actor.call.remote(positions, 1)] = actor
    ray.get(list(flying))
    call_us = 1e6 * (time.perf_counter() - began) / calls
    weights = np.zeros(MEGABYTES * 10**6, dtype=np.uint8)
    taken = []
    for _ in range(5):
        began = time.perf_counter()
        ray.get(actors[0].take.remote(ray.put(weights)))
        taken.append(time.perf_counter() - began)
    ray.shutdown()
    return {"call_us": call_us, "transfer_mb_s": MEGABYTES / float(np.median(taken))}


if __name__ == "__main__":
    calls_, commits_ = map(int, sys.argv[1:])
    print(json.dumps({"commit_ms": commit_ms(commits_), **ray_parts(calls_)}))
