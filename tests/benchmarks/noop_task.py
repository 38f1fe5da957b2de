"""Task that does nothing and returns one score: its time is the service's own time.

SHIFT3D_BENCH_MARKS names a folder in which each worker notes the time at which it was ready.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.reading import Catalogue, read_catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.schema.config import Config
from shift3d.settings.schema.scenes import StreetConfig
from shift3d.sweep.planning.kind import TaskKind
from shift3d.task.assets import load_assets
from shift3d.task.exchange import AssetsSpec, TaskResult
from shift3d.task.run import run_task
from shift3d.task.spec import TaskSpec

_ROW = {
    "method": "adversarial", "replicate": 0, "x_m": 20.0, "y_m": 0.0, "z_m": 0.0, "yaw_rad": 0.0, "pitch_rad": 0.0,
    "roll_rad": 0.0, "score": 0.5, "adversarial_loss": 0.5, "range_m": 20.0, "latent_distance": 0.1,
    "object_points": 400, "overlap_ok": True, "contact_ok": True, "best_step": 3, "status": "ok",
    "max_residual_m": 0.0, "unresolved_beams": 0, "scored_by": "pointpillars",
}  # fmt: skip


def load(spec: AssetsSpec) -> None:
    _note()


def run(spec: TaskSpec, assets: None) -> TaskResult:
    return TaskResult([_ROW], [], [])


def load_real(spec: AssetsSpec) -> Any:
    """Load the real task's assets and note the time at which a worker has them."""
    assets = load_assets(spec)
    _note()
    return assets


def _note() -> None:
    (Path(os.environ["SHIFT3D_BENCH_MARKS"]) / f"{os.getpid()}").write_text(repr(time.time()))


def catalogue(config: Config) -> Catalogue:
    assert isinstance(config.scenes, StreetConfig)
    names = [f"street_{index:07d}" for index in range(config.scenes.count)]
    return Catalogue(
        scenes=tuple(SceneEntry(name, "street-hdl64", f"hash-{name}", SceneFacts(name)) for name in names),
        scene_arguments={"kind": "street"},
        sector_rad=(0.0, 3.14),
        vehicles={"coupe": "hash-coupe"},
        decoder_hash="decoder",
        detectors={"pointpillars": "detector"},
        accuracy={},
    )


NOOP = TaskKind(run=run, load=load, catalogue=catalogue, memory_mb=200.0)
REAL = TaskKind(run=run_task, load=load_real, catalogue=read_catalogue)
