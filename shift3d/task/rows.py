"""Rows of a task's results, for the tables of design section 5."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from torch import Tensor

from shift3d.attack.objective import latent_distance
from shift3d.attack.records import AttackResult, StepRecord
from shift3d.naturalness.measure import NaturalnessMeasure
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.task.audit import Audit
from shift3d.task.exchange import Row, TaskResult
from shift3d.task.scoring import Candidate, ScoredObject
from shift3d.task.spec import TaskSpec

_SIZES = ("length_m", "width_m", "height_m", "clearance_m", "asymmetry_cm")


class Rows:
    """Collects the rows of one task; `skip` adds no row for a (method, replicate) that was added."""

    def __init__(self, spec: TaskSpec) -> None:
        self._spec = spec
        self._found = TaskResult()
        self._timings: dict[tuple[str, str], tuple[float, int]] = {}
        self._seen: set[tuple[str, int]] = set()
        self._descent: dict[str, Row] = {}

    def add(
        self,
        candidate: Candidate,
        baseline_code: Tensor,
        scored: ScoredObject,
        audit: Audit | None = None,
        naturalness: NaturalnessMeasure | None = None,
    ) -> None:
        """Add one scored object: a row for each detector, and the solution, from which it can be rendered again.

        audit: of its rendering, if audited. naturalness: of its shape, if measured.
        """
        measured, theta = scored.measurement, [float(value) for value in candidate.theta]
        check, rendering = measured.check, measured.rendering
        pose = dict(zip(POSE_COLUMNS, theta, strict=True))
        same: Row = pose | {
            "latent_distance": latent_distance(candidate.code, baseline_code),
            "range_m": math.hypot(theta[0], theta[1]),
            "object_points": rendering.object_points,
            "overlap_ok": check.overlap_ok,
            "contact_ok": check.contact_ok,
            "best_step": candidate.best_step,
            "max_residual_m": rendering.max_residual_m,
            "unresolved_beams": rendering.unresolved_beams,
        }
        if audit is not None:
            same |= audit.columns()
            self.time(candidate.method, "audit", audit.milliseconds)
        if naturalness is not None:
            same |= _summary(naturalness)
            if self._spec.mode != "pose" or candidate.method == "baseline":
                shape = {"method": candidate.method, "replicate": candidate.replicate}
                self._found.shapes.append(shape | shape_columns(naturalness))
        for name in self._spec.scored_by:
            result = scored.results[name]
            row = self._row(name, candidate.method, candidate.replicate, candidate.status)
            values = {"score": result.score, "adversarial_loss": result.adversarial_loss}
            broken = sum(not math.isfinite(value) for value in values.values())
            self._found.scores.append(row | same | values | {"non_finite": measured.non_finite + broken})
        self._found.solutions.append(
            {
                "method": candidate.method,
                "replicate": candidate.replicate,
                "effects": list(self._spec.effects),
                "drawn_as": None if candidate.vehicle is None else candidate.vehicle.name,
                "latent_code": np.asarray(candidate.code, dtype=np.float32).tolist(),
            }
            | pose
        )
        self._seen.add((candidate.method, candidate.replicate))
        for stage, milliseconds in scored.milliseconds.items():
            self.time(candidate.method, stage, milliseconds)

    def skip(self, method: str, replicate: int, status: str) -> None:
        """Add a row per detector without a score, unless (method, replicate) has rows: no gap is ever silent."""
        if (method, replicate) not in self._seen:
            self._found.scores.extend(self._row(name, method, replicate, status) for name in self._spec.scored_by)

    def attack(self, found: AttackResult) -> None:
        """Add the search's steps, its time by stage, and the gradient measures of its start and its end."""
        self._found.trajectories.extend(_step_row(record, found.best_step) for record in found.trace)
        whole = sum(record.non_finite for record in found.trace)
        ends = (("baseline", found.trace[0], found.trace[:1], 0), ("adversarial", found.best, found.trace, whole))
        for method, record, steps, met in ends:
            slope = record.least_slope if math.isfinite(record.least_slope) else None
            shares = [step.grazing_gradient for step in steps if step.grazing_gradient is not None]
            share = math.fsum(shares) / len(shares) if shares else None
            self._descent[method] = {"least_slope": slope, "grazing_gradient": share, "non_finite": met}
        self.search_time("adversarial", found)

    def search_time(self, method: str, found: AttackResult) -> None:
        """Add the time of a search, by stage."""
        for stage, milliseconds in found.milliseconds().items():
            self.time(method, stage, milliseconds, len(found.trace))

    def transfers(self, rows: Iterable[Row]) -> None:
        """Add the results of the adversarial shape in other scenes."""
        self._found.transfers.extend(rows)

    def time(self, method: str, stage: str, milliseconds: float, calls: int = 1) -> None:
        """Add time to one stage of one method."""
        spent, count = self._timings.get((method, stage), (0.0, 0))
        self._timings[method, stage] = (spent + milliseconds, count + calls)

    def result(self) -> TaskResult:
        """Return everything collected."""
        timings: list[Row] = [
            {"method": method, "stage": stage, "milliseconds": spent, "calls": calls}
            for (method, stage), (spent, calls) in self._timings.items()
        ]
        return replace(self._found, scores=[self._described(row) for row in self._found.scores], timings=timings)

    def _described(self, row: Row) -> Row:
        """Add the search's measures to a row; the non-finite numbers of search and scoring are summed."""
        if row["status"] == "no_placement" or row["method"] not in self._descent:
            return row
        descent = self._descent[row["method"]]
        return row | descent | {"non_finite": row["non_finite"] + descent["non_finite"]}

    def _row(self, scored_by: str, method: str, replicate: int, status: str) -> Row:
        return {
            "scored_by": scored_by,
            "method": method,
            "replicate": replicate,
            "status": status,
            "effects": list(self._spec.effects),
        }


def _step_row(record: StepRecord, best_step: int) -> Row:
    """Return a step as the search recorded it; a number that is not finite, as in a divergence, becomes None."""
    losses = {
        "proposal_score": record.proposal_score,
        "loss": record.loss,
        "adversarial_loss": record.adversarial_loss,
        "latent_distance": record.latent_distance,
    }
    return {
        "step": record.step,
        "kept": record.step == best_step,
        **{name: value if math.isfinite(value) else None for name, value in losses.items()},
        **dict(zip(POSE_COLUMNS, record.theta, strict=True)),
        "object_points": record.check.object_points,
        "valid": record.valid,
    }


def _summary(found: NaturalnessMeasure) -> Row:
    """Return the naturalness columns of the scores."""
    nearest = found.nearest
    return {
        "surface_distance_cm": nearest.mean_cm if nearest else None,
        "surface_distance_p95_cm": nearest.p95_cm if nearest else None,
        "naturalness_percentile": found.percentile,
        "natural": found.natural,
    }


def shape_columns(found: NaturalnessMeasure) -> Row:
    """Return the columns of the shapes.

    For a code without a surface all but the share are None; so is the clearance of a shape without a middle.
    """
    nearest, sizes = found.nearest, found.sizes
    measured = {name: getattr(sizes, name, math.nan) for name in _SIZES}
    row: Row = {name: value if math.isfinite(value) else None for name, value in measured.items()}
    for direction in ("to_member", "from_member"):
        mean, p95 = getattr(nearest, f"{direction}_cm", (None, None))
        row |= {f"{direction}_cm": mean, f"{direction}_p95_cm": p95}
    member = nearest.name if nearest else None
    return row | {
        "nearest_member": member,
        "largest_piece": found.largest_piece,
        "out_of_range": list(found.out_of_range),
    }
