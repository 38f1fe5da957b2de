"""Verification: scores solutions again, so that no reported blind spot is a rounding error of its search.

Each solution of a finished task is rendered again in four ways: at the sweep's own accuracy (the score must be the
same); at reference accuracy with the detectors in float64 (`score_reference`); with new noise along the beams that hit
the object; and near its pose. The baseline is rendered in the same ways with the same draws, because the margin counts:
whether the solution is still below its baseline by the same margin.

stable: score and margin are within `SCORE_TOLERANCE` of the reference's. A property of the arithmetic.
robust: under every draw of noise and pose at least half of the margin is left, or at most 0.02 is lost. A property of
the blind spot.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from statistics import fmean

import numpy as np
import torch

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.resolve import as_location
from shift3d.store.rows_by_task import RowsByTask
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec, Row, TaskResult
from shift3d.task.follow_ups.rescoring import Solution, VerificationProblems, VerificationResult, verify_object
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.vehicle import Vehicle

SCORE_TOLERANCE = 0.02
"""Largest difference of a score or a margin from its value at reference accuracy."""


@dataclass
class VerifyAssets:
    """Assets of a worker: the sweep's assets, and the folder of its final tables."""

    assets: Assets
    results: Location
    _tables: dict[str, RowsByTask] = field(default_factory=dict)
    _baselines: dict[tuple[str, bytes, bytes], VerificationResult] = field(default_factory=dict)

    def solutions(self, spec: TaskSpec) -> list[Solution]:
        """Return every solution of a task with its scores, the baseline first; empty if nothing could be placed.

        Raises: InputError: tables that are missing, damaged, or lack the baseline.
        """
        rows = {name: self._rows(name, spec.task_id) for name in ("scores", "solutions")}
        scores: dict[tuple[str, int], dict[str, float]] = {}
        for row in rows["scores"]:
            if row["score"] is not None:
                scores.setdefault((row["method"], row["replicate"]), {})[row["scored_by"]] = row["score"]
        found = [
            Solution(
                row["method"],
                row["replicate"],
                torch.tensor(np.asarray(row["latent_code"], dtype=np.float32)),
                torch.tensor([row[name] for name in POSE_COLUMNS], dtype=torch.float64),
                scores[row["method"], row["replicate"]],
                self._other_vehicle(spec, row),
            )
            for row in rows["solutions"]
        ]
        if found and found[0].method != "baseline":
            raise InputError(f"task {spec.task_id} has no baseline", where=str(self.results / "solutions.parquet"))
        return found

    def _other_vehicle(self, spec: TaskSpec, row: Row) -> Vehicle | None:
        found = self.assets.rendered_vehicle(spec, row)
        return None if found.name == spec.vehicle else found

    def _rows(self, name: str, task_id: str) -> list[Row]:
        if name not in self._tables:
            self._tables[name] = RowsByTask(self.results / f"{name}.parquet", name)
        return self._tables[name].of(task_id)

    def verified(
        self, spec: TaskSpec, solution: Solution, problems: VerificationProblems
    ) -> tuple[VerificationResult, bool]:
        """Verify a solution. Also returns False if the result was known: tasks of one place share their baseline."""
        if solution.method != "baseline":
            return verify_object(spec, solution, problems), True
        # A sweep may hold results of two machines that rounded differently.
        key = (spec.baseline.task_id, solution.code.numpy().tobytes(), solution.theta.numpy().tobytes())
        new = key not in self._baselines
        if new:
            self._baselines[key] = verify_object(spec, solution, problems)
        return self._baselines[key], new


def load_verify_assets(spec: AssetsSpec) -> VerifyAssets:
    """Load the shared assets of the verification of a sweep's tasks.

    Raises: InputError: as `load_assets`; or this machine cannot read the sweep's folder, so that it can run no task.
    """
    assert spec.results is not None
    results = as_location(spec.results)
    if not (table := results / "solutions.parquet").is_file():
        remedy = "Put the sweep's folder where every machine finds it, or into a bucket: workers read its tables"
        raise InputError("is not there on this machine", where=str(table), remedy=remedy)
    return VerifyAssets(load_assets(spec), results)


def verify_task(spec: TaskSpec, held: VerifyAssets) -> TaskResult:
    """Verify every solution of one finished task: a row for each solution and detector.

    The result is a pure function of the spec, the solutions and the content that the spec's hashes name, on one thread.
    Raises: InputError: tables, a scene or a vehicle that cannot be loaded, or that are not those of the sweep.
    Source: our choice: the paper scores once.
    """
    solutions = held.solutions(spec)
    if not solutions:
        return TaskResult()
    own = VerificationProblems.of(spec, held.assets, solutions[0])
    rows: list[Row] = []
    timings: list[Row] = []
    baseline: VerificationResult | None = None
    for solution in solutions:
        problems = own
        if solution.vehicle is not None:
            problems = replace(VerificationProblems.of(spec, held.assets, solution), nearby=own.nearby)
        verified, new = held.verified(spec, solution, problems)
        baseline = baseline or verified
        known = {"method": solution.method, "replicate": solution.replicate}
        rows += [known | row for row in verified_rows(solution, verified, solutions[0], baseline)]
        timings += [
            {"method": solution.method, "stage": stage, "milliseconds": spent, "calls": 1}
            for stage, spent in verified.milliseconds.items()
            if new
        ]
    return TaskResult(timings=timings, verification=rows)


def verified_rows(
    solution: Solution, verified: VerificationResult, start: Solution, baseline: VerificationResult
) -> list[Row]:
    """Return a row per detector, without the columns of the spec. start, baseline: the task's own baseline."""
    found = asdict(verified.found)
    same: Row = {
        "hits_reference": found.pop("hits"),
        **found,
        "unresolved_beams": verified.unresolved,
        "unresolved_reference": verified.unresolved_reference,
    }
    rows = []
    for name, score in solution.scores.items():
        reference = verified.reference[name]
        margin = start.scores[name] - score
        margin_reference = baseline.reference[name] - reference
        noise = [b - s for b, s in zip(baseline.noise[name], verified.noise[name], strict=True)]
        nearby = [b - s for b, s in zip(baseline.nearby[name], verified.nearby[name], strict=True)]
        moved, margin_moved = abs(score - reference), abs(margin - margin_reference)
        stable = max(moved, margin_moved) <= SCORE_TOLERANCE
        row: Row = {
            "scored_by": name,
            "score": score,
            "score_again": verified.again[name],
            "score_reference": reference,
            "margin": margin,
            "margin_reference": margin_reference,
            "score_noise": fmean(verified.noise[name]),
            "least_margin_noise": min(noise),
            "score_nearby": fmean(verified.nearby[name]),
            "least_margin_nearby": min(nearby),
            "stable": stable,
            "robust": min(*noise, *nearby) >= margin - max(SCORE_TOLERANCE, margin / 2),
            "cause": None if stable else _cause(name, score, verified, baseline, moved),
        }
        rows.append(row | same)
    return rows


def _cause(name: str, score: float, verified: VerificationResult, baseline: VerificationResult, moved: float) -> str:
    """Explain why a score or a margin differs from the reference's."""
    if verified.again[name] != score:
        return f"not reproduced: at the sweep's own accuracy it is {verified.again[name]:.3f} now"
    of, whose = (verified, "its") if moved > SCORE_TOLERANCE else (baseline, "the baseline's")
    found = of.found
    if of.unresolved or of.unresolved_reference:
        return f"{of.unresolved} of {whose} beams unresolved, {of.unresolved_reference} in the reference"
    if not found.all_hits_agree:
        lost = f"{found.missed_hits} missed, {found.false_hits} false, {found.wrong_surface} on another surface"
        return f"of {whose} {found.hits} hits {lost}"
    depth = f"depth error at most {1e3 * found.depth_error_max_m:.2g} mm"
    return f"{whose} hits are those of the reference ({depth}): the detector is steep here"
