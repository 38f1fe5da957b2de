"""A handmade finished sweep: two tasks, their plan, the commit log and the segments; and a measured frontier."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from pathlib import Path
from typing import Any

import pyarrow as pa

from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import Config
from shift3d.store.frontier_table import FRONTIER_SCHEMA, frontier_table
from shift3d.store.log import CommitLog
from shift3d.store.schemas import SCHEMAS
from shift3d.store.tables import table_from_rows, write_table
from shift3d.sweep.planning.folder import open_folder
from shift3d.sweep.planning.plan import Plan, make_plan

METHODS = ("baseline", "random", "adversarial")
FRONTIER = "frontier.parquet"
SCENES = ("north", "south")
DRIVER = "1-0a1b2c3d"
_BY_TYPE: dict[Any, Any] = {pa.string(): "text", pa.float64(): 0.5, pa.int32(): 1, pa.int64(): 1, pa.bool_(): True}


def catalogue(config: Config) -> Catalogue:
    return Catalogue(
        scenes=tuple(SceneEntry(name, "street-hdl64", name[0], SceneFacts(name)) for name in SCENES),
        scene_arguments={"kind": "street"},
        sector_rad=(0.5, 1.0),
        vehicles={"suv": "hash"},
        decoder_hash="d",
        detectors={config.detector.name: "p"},
        accuracy={"step_m": 0.02},
    )


@functools.cache
def plan() -> Plan:
    """Plan suv in two scenes, shape alone."""
    return make_plan(compose_sweep("smoke", ["vehicle=suv", "mode=shape"]), catalogue)[0]


def rows(name: str, task: Any) -> list[dict[str, Any]]:
    """Return rows of a segment table: the task's values, and any value of the right type in other columns."""
    found = []
    for index, method in enumerate(METHODS):
        row = {field.name: _BY_TYPE.get(field.type) for field in SCHEMAS[name]}
        given = {key: getattr(task.spec, key) for key in row if hasattr(task.spec, key)}
        row |= given | {"method": method, "lambda": task.spec.lambda_, "scored_by": task.spec.detector, "status": "ok"}
        row |= {"score": 0.9 - 0.3 * index, "sweep": plan().sweep, "attempt": index + 1, "replicate": 0}
        lists = {"effects": [], "latent_code": [0.25, -0.5]}
        row |= {key: value for key, value in lists.items() if key in row}
        found.append({key: value for key, value in row.items() if key in SCHEMAS[name].names})
    return found


@functools.cache
def _finished() -> Path:
    """Write the sweep once; nobody changes it."""
    folder = Path(tempfile.mkdtemp(prefix="valid-sweep-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    open_folder(folder, plan())
    log = CommitLog(folder, plan().spec_hash)
    for task in plan().tasks:
        names = ("scores", "solutions", "timings", "attempts")
        log.commit((task.spec.task_id,), (), {name: table_from_rows(name, rows(name, task)) for name in names})
    # The driver's name differs in every process, and is part of file names and log entries.
    for path in [*(folder / "_log").glob("*.json"), *(folder / "data").iterdir()]:
        if path.suffix == ".json":
            path.write_text(path.read_text().replace(log.driver, DRIVER))
        path.rename(path.with_name(path.name.replace(log.driver, DRIVER)))
    return folder


def write_sweep(folder: Path) -> None:
    """Copy the finished sweep: spec.yaml, env.json, plan.parquet, _log, data."""
    shutil.copytree(_finished(), folder, dirs_exist_ok=True)


def write_frontier(folder: Path) -> None:
    """Write frontier.parquet of two settings."""
    measured = []
    for name in ("standard", "paper"):
        row = {field.name: _BY_TYPE[field.type] for field in FRONTIER_SCHEMA}
        conditions = {"start": "cold", "gradient": "no"}
        measured.append({**row, **conditions, "setting": name, "preset": name, "knob": None, "knob_name": None})
    write_table(folder / FRONTIER, frontier_table(measured, {"cores": 2}))
