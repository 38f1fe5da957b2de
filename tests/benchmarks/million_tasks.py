"""A sweep of a million tasks in its own process on one core: planned, nearly finished, or resumed.

Usage: python -m benchmarks.million_tasks plan|finish|resume|read FOLDER SCENES. Prints its findings as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pyarrow as pa
from benchmarks.worker_memory import peak_mb

from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import Config
from shift3d.settings.schema.scenes import StreetConfig
from shift3d.store.log import CommitLog
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.plan import Plan, make_plan

VEHICLES = ("coupe", "sports_car", "suv", "convertible", "beach_wagon")
LAMBDAS = ("0.1", "1", "10", "100")
COMMIT = 5_000
_DONE_SHARE = 0.99


def catalogue(config: Config) -> Catalogue:
    """Return scenes by name alone: making or reading a scene and hashing it takes longer than to plan on it."""
    assert isinstance(config.scenes, StreetConfig)
    names = [f"street_{number:06d}" for number in range(config.scenes.count)]
    return Catalogue(
        scenes=tuple(SceneEntry(name, "street-hdl64", f"{name:0>32}", SceneFacts(name)) for name in names),
        scene_arguments=config.scenes.model_dump(mode="json", exclude={"count"}),
        sector_rad=(0.0, 3.14),
        vehicles={name: f"{name:0>32}" for name in VEHICLES},
        decoder_hash="0" * 32,
        detectors={config.detector.name: "1" * 32},
        accuracy={},
    )


def plan_of(scenes: int) -> Plan:
    """Plan five vehicles under four lambda in this many scenes."""
    words = [f"vehicle={','.join(VEHICLES)}", "mode=shape", f"attack.lambda={','.join(LAMBDAS)}"]
    return make_plan(compose_sweep("default", [*words, f"scenes.count={scenes}"]), catalogue)[0]


def finish(folder: Path, plan: Plan) -> None:
    """Commit most tasks, a few thousand at a time, without rows: resuming reads the log, not the segments."""
    log, ids = CommitLog(folder, plan.spec_hash), plan.tasks.ids.to_pylist()
    for start in range(0, int(len(ids) * _DONE_SHARE), COMMIT):
        log.commit(tuple(ids[start : start + COMMIT]), (), {})


def main(what: str, path: str, scenes: str) -> None:
    """Run one step; print the number of tasks, the number left, and this process's peak memory."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    pa.set_cpu_count(1)
    folder = Path(path)
    plan = read_plan(folder) if what == "read" else plan_of(int(scenes))
    open_folder(folder, plan)
    if what == "finish":
        finish(folder, plan)
    left = len(plan.tasks)
    if what in ("resume", "read"):
        log = CommitLog(folder, plan.spec_hash)
        left = len(plan.tasks.without(log.done() | log.quarantined()))
    print(json.dumps({"tasks": len(plan.tasks), "left": left, "peak_mb": peak_mb()}))


if __name__ == "__main__":
    main(*sys.argv[1:])
