"""What travels between driver and workers beside specs: settings of what a worker loads, and rows of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Row = dict[str, Any]


@dataclass(frozen=True)
class TaskResult:
    """What a task hands back: rows of plain Python and NumPy values, in a fixed order.

    scores, solutions, timings: rows whose keys are the columns of design section 5 that the spec does not
    already determine (the columns of ``store.schemas.SPEC_COLUMNS`` are filled in by the sweep).
    verification: likewise, of a task that verifies another one's solutions. trajectories: likewise, a row a step.
    transfers: likewise, a row a scene that a solution was put into and a detector. shapes: likewise, a row a shape.
    vehicle_pool: a row a labelled vehicle of the task's scene. retrieved: a row a vehicle of a pool and a detector.
    patterns: a row a mesh that was measured.
    """

    scores: list[Row]
    solutions: list[Row]
    timings: list[Row]
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
