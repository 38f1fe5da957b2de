"""Data between driver and workers besides task specs: settings of a worker's assets, and rows of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Row = dict[str, Any]


@dataclass(frozen=True)
class TaskResult:
    """Result of a task: rows of plain Python and NumPy values, in a fixed order, for the tables with these names.

    The rows hold the columns that the spec does not determine; the sweep adds `store.schemas.SPEC_COLUMNS`.
    """

    scores: list[Row] = field(default_factory=list)
    solutions: list[Row] = field(default_factory=list)
    timings: list[Row] = field(default_factory=list)
    verification: list[Row] = field(default_factory=list)
    trajectories: list[Row] = field(default_factory=list)
    transfers: list[Row] = field(default_factory=list)
    shapes: list[Row] = field(default_factory=list)
    vehicle_pool: list[Row] = field(default_factory=list)
    retrieved: list[Row] = field(default_factory=list)
    patterns: list[Row] = field(default_factory=list)


@dataclass(frozen=True)
class AssetsSpec:
    """Settings of the assets that a worker loads once: plain values; task ids depend on no path in them.

    scenes, vehicles: settings of the scene set and of the source of vehicles, as in their schemas. detectors: name to a
    file of weights, or None for the weights that ship with shift3d. hashes: hashes of "decoder" and the detectors in
    the plan; a missing hash is not compared. results: folder of the final tables that a verification reads. modules:
    Python files of the user's own detectors, by name. layouts: of foreign detectors, by name, see
    `detectors.foreign.layout`. reference: settings of the reference set of naturalness, None: naturalness is not
    measured.
    """

    scenes: Mapping[str, Any]
    vehicles: Mapping[str, Any] = field(default_factory=lambda: {"kind": "set", "folder": None})
    detectors: Mapping[str, str | None] = field(default_factory=lambda: {"pointpillars": None})
    hashes: Mapping[str, str] = field(default_factory=dict)
    threads: int = 1
    results: str | None = None
    modules: Mapping[str, str] = field(default_factory=dict)
    layouts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    reference: Mapping[str, Any] | None = None
