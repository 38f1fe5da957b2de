"""Immutable files of an output folder: spec.yaml, env.json, plan.parquet."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import platform
from collections.abc import Callable, Iterable
from typing import Any

import yaml  # type: ignore[import-untyped]

import shift3d
from shift3d.errors import InputError
from shift3d.processor import instructions
from shift3d.settings.compose import leaves
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.schemas import SCHEMA_VERSION
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.plan_file import plan_bytes, read_tasks, stored_effect_requests
from shift3d.sweep.planning.spec_file import read_spec, refuse_follow_up
from shift3d.task.exchange import AssetsSpec
from shift3d.wording import counted

_LIBRARIES = ("numpy", "torch", "trimesh", "embreex", "scipy", "pyarrow", "ray", "hydra-core", "pydantic")


def default_folder(plan: Plan) -> Location:
    """Return ``outputs/<name>-<hash of the spec>`` in the working directory."""
    return as_location("outputs") / f"{plan.sweep}-{plan.spec_hash}"


def check_folder(folder: LocationLike, plan: Plan) -> bool:
    """Check that a plan can run in a folder, without changes. Return True if the plan was begun there.

    Raises: InputError: the folder holds another sweep or something else, or cannot be written to.
    """
    folder = as_location(folder)
    folder.check_writable()
    begun = (folder / "spec.yaml").is_file()
    if begun:
        found = read_spec(folder)
        if found["spec_hash"] != plan.spec_hash:
            remedy = "Choose another folder with out=DIR, or give the settings that it was begun with"
            raise InputError(f"holds another sweep ({_difference(found, plan)})", str(folder), remedy)
        if not any(assets.results for assets in plan.assets):
            refuse_follow_up(found, folder)
        _check_requests(folder, plan)
    elif not _empty_or_begun(folder):
        what = "is not the output folder of a sweep, and not empty"
        raise InputError(what, str(folder), "Choose another folder with out=DIR")
    return begun


def open_folder(folder: LocationLike, plan: Plan, here: Callable[[], str] = instructions) -> None:
    """Create a sweep's folder, or check that an existing one has the same plan.

    here: describes this processor, see `TaskKind`. Raises: InputError: see `check_folder`; or the disk is full.
    """
    folder = as_location(folder)
    # spec.yaml is first: it decides which plan owns the folder, and only drivers of that plan write further files.
    begun = check_folder(folder, plan)
    if not begun and not (folder / "spec.yaml").put_if_absent(_spec_bytes(plan)):
        begun = check_folder(folder, plan)  # another driver was faster: its plan must be the same
    if not begun or not (folder / "env.json").is_file():  # or a driver was killed before env.json
        (folder / "plan.parquet").write_atomic(plan_bytes(plan.tasks))
        environment = json.dumps(_environment(here()), indent=1, sort_keys=True)
        (folder / "env.json").write_atomic(environment.encode() + b"\n")


def _empty_or_begun(folder: Location) -> bool:
    """True if the folder is absent, empty, or has only plan.parquet or env.json, left by a killed driver."""
    try:
        return not folder.is_file() and set(folder.names()) <= {"plan.parquet", "env.json"}
    except NotADirectoryError:
        return False


def _check_requests(folder: Location, plan: Plan) -> None:
    """Refuse a plan of equal tasks with other requested effects: the folder's plan lacks the groups of its tables."""
    path = folder / "plan.parquet"
    complete = (folder / "env.json").is_file() and path.is_file()  # env.json is last; without it the plan is rewritten
    if complete and (begun := stored_effect_requests(path.read_bytes(), plan.tasks)):
        what = f"holds the same tasks, begun with effects={','.join(begun)}, which come to the same in these scenes"
        raise InputError(what, str(folder), "Choose another folder with out=DIR, or give those effects")


def _difference(found: dict[str, Any], plan: Plan) -> str:
    if found["sweep"] != plan.sweep:
        return f"{found['sweep']}, not {plan.sweep}"
    if found["tasks"] != len(plan.tasks):
        return f"{counted(found['tasks'], 'task')}, not {len(plan.tasks)}"
    old, new = dict(leaves(found["settings"])), dict(leaves(plan.settings))
    changed = [f"{key} {old.get(key)}, not {new.get(key)}" for key in sorted(old | new) if old.get(key) != new.get(key)]
    # A processor without bfloat16 searches in float32, unless accuracy.detector sets the type.
    others = "made from other scenes, vehicles, weights, axes or accuracy.detector, or by another version of shift3d"
    return changed[0] if changed else others


def _spec_bytes(plan: Plan) -> bytes:
    values = {
        "schema_version": SCHEMA_VERSION,
        "sweep": plan.sweep,
        "spec_hash": plan.spec_hash,
        "tasks": len(plan.tasks),
        "overrides": list(plan.overrides),
        "axes": plan.axes,
        "settings": plan.settings,
        "skipped": dict(plan.skipped),
        "assets": [dataclasses.asdict(assets) for assets in plan.assets],
    }
    text: str = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    return text.encode()


def _environment(processor: str) -> dict[str, Any]:
    """Return the driver's versions and machine, for readers who ask why the results of two machines differ."""
    return {
        "shift3d": shift3d.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "instructions": processor,
        "cpus": os.cpu_count(),
        "libraries": library_versions(_LIBRARIES),
    }


def read_environment(folder: LocationLike) -> dict[str, Any]:
    """Return the versions and the machine of the driver that began a sweep: the content of ``env.json``.

    Raises: InputError: the file is absent or damaged.
    """
    path = as_location(folder) / "env.json"
    try:
        values = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        what = f"cannot be read ({type(error).__name__})"
        raise InputError(what, where=str(path), remedy="Restore it from a copy") from error
    if not isinstance(values, dict):
        raise InputError("is not what a sweep wrote", where=str(path), remedy="Restore it from a copy")
    return values


def library_versions(names: Iterable[str]) -> dict[str, str]:
    """Return the versions installed on this machine, by name; "absent" for a missing library."""
    versions = {}
    for name in names:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "absent"
    return versions


def read_plan(folder: LocationLike) -> Plan:
    """Return the plan of a sweep's folder, with every task's spec: the input of exports and reports.

    Raises: InputError: the folder is not a sweep's, or a file in it is damaged.
    """
    folder = as_location(folder)
    spec = read_spec(folder)
    path = folder / "plan.parquet"
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where=str(path), remedy="Restore it from a copy") from error
    tasks = read_tasks(content, str(path))
    try:
        plan = Plan(
            sweep=spec["sweep"],
            overrides=tuple(spec["overrides"]),
            settings=dict(spec["settings"]),
            axes=dict(spec["axes"]),
            tasks=tasks,
            assets=tuple(AssetsSpec(**assets) for assets in spec["assets"]),
            skipped={str(name): str(why) for name, why in dict(spec.get("skipped", {})).items()},
        )
        # The hash depends on every task, so that it shows a change in either file.
        complete = plan.spec_hash == spec["spec_hash"]
        complete &= bool(((tasks.assets >= 0) & (tasks.assets < len(plan.assets))).all())
    except (KeyError, ValueError, TypeError) as error:
        what = f"is not the spec of a sweep ({type(error).__name__}: {error})"
        raise InputError(what, where=str(folder / "spec.yaml"), remedy="Restore it from a copy") from error
    if not complete:
        what = "spec.yaml and plan.parquet are not of one sweep, or damaged"
        raise InputError(what, where=str(folder), remedy="Restore both from a copy")
    return plan
