"""Mesh measures of a task: of the baseline's mesh and of the adversarial shape's mesh."""

from __future__ import annotations

import time
from dataclasses import asdict

from shift3d.errors import InputError
from shift3d.naturalness.decoded import decoded_mesh
from shift3d.task.exchange import Row, TaskResult
from shift3d.task.follow_ups.rescoring import Solution
from shift3d.task.follow_ups.verify import VerifyAssets
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.mesh_measures import measure_mesh

RESOLUTION = 97
"""Nodes along the unit sphere's cube for the meshes: 5 cm apart on a car; lengths are exact to a centimetre."""


def patterns_task(spec: TaskSpec, held: VerifyAssets) -> TaskResult:
    """Measure the baseline's and the adversarial mesh of a task; a pose task gives no rows.

    A code without a surface has no measures.
    Raises: InputError: tables or a vehicle that cannot be loaded, or that are not those of the sweep.
    Source: our choice of measures; SHIFT3D names such patterns by eye (fig:z_figures).
    """
    start = time.perf_counter()
    solutions = held.solutions(spec) if spec.mode != "pose" else []
    rows = [
        {"method": found.method, "replicate": found.replicate, **_measured(spec, held, found)}
        for found in solutions
        if found.method in ("baseline", "adversarial")
    ]
    spent: Row = {"method": "patterns", "stage": "measure", "milliseconds": 1e3 * (time.perf_counter() - start)}
    return TaskResult(timings=[spent | {"calls": len(rows)}], patterns=rows)


def _measured(spec: TaskSpec, held: VerifyAssets, found: Solution) -> Row:
    vehicle = found.vehicle or held.assets.vehicle(spec)
    try:
        mesh = decoded_mesh(vehicle, held.assets.decoder, found.code.numpy(), RESOLUTION)
    except InputError:  # a code without a surface
        return {}
    return asdict(measure_mesh(mesh))
