"""Retrieval of natural vehicles near a finished sweep's shapes: a pool of vehicles from scenes, and its nearest scored.

Both steps are sweeps. The tasks of the pool are scenes, in a separate folder that any sweep may use; the tasks of the
scoring are the sweep's tasks, in its folder.
"""

from __future__ import annotations

import dataclasses
import hashlib

from shift3d.errors import InputError
from shift3d.settings.schema.config import RunnerConfig
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.sweep.drive import SweepResult, run_sweep
from shift3d.sweep.follow_up import follow_up, follow_up_kind, follow_up_tables, solved_tasks
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.planning.plan import Plan

FOLDER = "retrieval"
"""Folder of the retrievals in a sweep's folder; each pool has a subfolder, a sweep's folder with a log."""
_POOL, _RETRIEVED = "vehicle_pool", "retrieved"
_VERSION = 3
"""Part of the pool's name and so of its hash; raised when a crop gets another fit or status under the same settings."""


def pool_plan(plan: Plan) -> Plan:
    """Return the plan of the pool for the scenes of a sweep's plan: one task per scene, the first in that scene.

    Raises: InputError: two scenes of a data set have one name, by which a pool distinguishes scenes.
    """
    first: dict[tuple[str, str], tuple[int, str]] = {}
    for position, task in enumerate(plan.tasks):
        spec = task.spec
        if first.setdefault((spec.dataset, spec.scene), (position, spec.scene_hash))[1] != spec.scene_hash:
            what = f"two scenes of {spec.dataset} are called {spec.scene}"
            raise InputError(what, "pool", "Give the scenes of one folder, made in one way; another pool takes others")
    name = f"{_POOL}_{_VERSION}"
    return dataclasses.replace(plan, sweep=name, tasks=plan.tasks.select(sorted(at for at, _ in first.values())))


def build_pool(folder: LocationLike, plan: Plan, runner: RunnerConfig) -> SweepResult:
    """Fit vehicles in the remaining scenes of a pool, and write ``final/vehicle_pool.parquet``. plan: of `pool_plan`.

    Like a sweep, it runs each task exactly once, and resumes to the same bytes. Raises: InputError as `run_sweep`.
    """
    from shift3d.task.follow_ups.vehicle_pool import load_pool_assets, pool_task

    return run_sweep(plan, runner, follow_up_kind(pool_task, load_pool_assets), folder, follow_up_tables(_POOL))


def retrieve(folder: LocationLike, pool: LocationLike, runner: RunnerConfig) -> SweepResult:
    """Score the pool vehicles nearest to a sweep's shapes; write ``vehicle_pool`` and ``retrieved`` into its
    ``final/``.

    folder: of the finished sweep. pool: of a finished pool, whose codes are of the same decoder. Like a sweep, it runs
    each task exactly once, and resumes to the same bytes.
    Raises: InputError as `run_sweep`, or if sweep or pool has not finished, or their decoders differ.
    """
    from shift3d.task.follow_ups.retrieval import load_retrieval_assets, retrieval_task

    folder, pool = as_location(folder), as_location(pool)
    plan = solved_tasks(folder)
    check_decoders(plan, read_plan(pool), str(pool))
    content, final = _pool_bytes(pool), folder / "final"
    kept = final / f"{_POOL}.parquet"
    if kept.is_file() and kept.read_bytes() != content:
        (final / f"{_RETRIEVED}.parquet").delete()  # of another pool, whose retrieval folder keeps a copy
    kept.write_atomic(content)
    digest = hashlib.blake2b(content, digest_size=6).hexdigest()
    kind = follow_up_kind(retrieval_task, load_retrieval_assets)
    return follow_up(folder, plan, runner, kind, folder / FOLDER / digest, _RETRIEVED)


def check_decoders(plan: Plan, pool: Plan, where: str) -> None:
    """Raise InputError if a pool's codes are of another decoder than the sweep's. where: the pool's folder."""
    ours, theirs = ({assets.hashes.get("decoder") for assets in one.assets} for one in (plan, pool))
    if ours != theirs:
        raise InputError(
            "its codes are of another decoder than the sweep's", where, "Give vehicle= as the sweep has it"
        )


def other_detector(plan: Plan, pool: Plan) -> str | None:
    """Return a note if the pool's detector is not one that the sweep attacked, else None. plan: of the sweep."""
    ours, theirs = ({group.template.detector for group in one.tasks.groups()} for one in (plan, pool))
    if theirs <= ours:
        return None
    one, other = (",".join(sorted(names)) for names in (theirs, ours))
    return f"{one} scores the vehicles in the log; the sweep attacked {other}: give detector={other}"


def _pool_bytes(pool: Location) -> bytes:
    path = pool / "final" / f"{_POOL}.parquet"
    if not path.is_file():
        raise InputError("no finished pool", where=str(pool), remedy="Run the command that began it: it resumes")
    return path.read_bytes()
