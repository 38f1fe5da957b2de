"""What travels between driver and workers beside specs: settings of what a worker loads, and rows of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Row = dict[str, Any]


@dataclass(frozen=True)
class TaskResult:
    """What a task hands back: rows of plain Python and NumPy values, in a fixed order, for the tables of these names.

    Their keys are the columns that the spec does not determine; the sweep fills in `store.schemas.SPEC_COLUMNS`.
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
    """What a worker loads once: plain values, no path that a task's id depends on.

    scenes, vehicles: settings of the scene set and of the source of vehicles, as their schemas have them.
    detectors: name to a file of weights, or None for the weights that ship with shift3d. hashes: what "decoder" and
    the detectors had when the sweep was planned; one that is not there is not compared. results: the folder of final
    tables that a verification reads. modules: Python files of detectors that are the user's own, by name. layouts: of
    foreign detectors, by name, see `detectors.foreign.layout`. reference: settings of the reference set of naturalness,
    None: it is not measured.
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
