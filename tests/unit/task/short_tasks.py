"""The real task shared by these tests: shipped weights, a procedural street, a short search."""

from __future__ import annotations

import dataclasses
from collections import OrderedDict
from typing import Any

from shift3d.settings.catalogue.reading import accuracy_settings, vehicle_source
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.task.assets import Assets
from shift3d.task.exchange import TaskResult
from shift3d.task.spec import AttackSpec, TaskSpec

STREET = {"kind": "street", "sensor": "hdl64", "split": "test", "seed": 0, "count": 2}
HERE, THERE = "street-test-hdl64-000000", "street-test-hdl64-000001"
SHORT = AttackSpec(steps=3, noise_replicates=2)
KNOWN = {"task_id": "t", "sweep": "s", "vehicle": "v", "scene": "s", "dataset": "d", "mode": "shape", "alpha": 0.01}
KNOWN |= {"detector": "p", "accuracy": "a", "search": "descent"}
"""Columns that a sweep fills in."""
WIDE = {"kind": "wide", "members": 40}
"""Settings of a small reference set."""


def make_spec(mode: str = "shape", **changes: object) -> TaskSpec:
    accuracy = accuracy_settings(AccuracyConfig(name="standard", render={}))
    spec = TaskSpec(
        vehicle="suv",
        scene=HERE,
        dataset="street-hdl64",
        mode=mode,  # type: ignore[arg-type]
        lambda_=1.0,
        alpha=0.01,
        detector="pointpillars",
        accuracy="standard",
        accuracy_settings=accuracy,
        attack=SHORT,
    )
    return dataclasses.replace(spec, **changes)  # type: ignore[arg-type]


def by_method(result: TaskResult, method: str) -> list[dict]:
    return [row for row in result.scores if row["method"] == method]


def with_own_caches(assets: Assets, **changes: Any) -> Assets:
    """Return the same assets as of a worker that ran no task; scenes and detectors, slow to load, are shared."""
    fresh: dict[str, Any] = {name: {} for name in ("poses", "_decoders", "_vehicle_hashes", "_own_naturalness")}
    fresh |= {"baselines": OrderedDict(), "_sdf_grids": OrderedDict()}
    return dataclasses.replace(assets, **fresh | changes)


def with_vehicles(assets: Assets, folder: str) -> Assets:
    """Return the same assets with the vehicles of a folder."""
    source = vehicle_source({"kind": "set", "folder": folder})
    return with_own_caches(assets, vehicles=source, decoder=source.decoder())
