"""Audit: measures a rendering's error on some beams of the very object that is reported.

`make frontier` measures a preset's error on other objects. The audit renders a few dozen of a row's own beams again at
reference accuracy (float64, along the decoder's linear regions) and compares. The beams are drawn from those that pass
the vehicle's box, half of them hits. The draw depends on the placement alone, so that a shape task and a pose task
report the same audit of their common baseline.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from shift3d.attack.problem import AttackProblem
from shift3d.render.beams import Beams
from shift3d.render.culling import Box, rays_in_box
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import REFERENCE
from shift3d.seeding import generator
from shift3d.task.assets import Assets
from shift3d.task.differences import Differences, differences
from shift3d.task.scoring import SCORED_NEARBY, Candidate, NoisyCopyScorer, ScoredObject, score_object
from shift3d.task.spec import TaskSpec

AUDITED = ("baseline", "adversarial")
"""Methods whose rows are audited; an audit costs about as much as the rendering itself."""
AUDITED_BEAMS = 32
_MARGIN_M = 0.1


@dataclass(frozen=True)
class Audit:
    """Number of audited beams, and their errors."""

    audited_beams: int
    found: Differences
    milliseconds: float

    def columns(self) -> dict[str, Any]:
        """Return the audit as columns of a row, without the time."""
        values = asdict(self.found)
        return {"audited_beams": self.audited_beams, "audited_hits": values.pop("hits"), **values}


def score_and_audit(
    spec: TaskSpec,
    assets: Assets,
    problem: AttackProblem,
    candidate: Candidate,
    nearby: NoisyCopyScorer | None = None,
    known: ScoredObject | None = None,
) -> tuple[ScoredObject, Audit | None]:
    """Score a candidate with every detector of the task, and audit its rendering if its method is audited.

    nearby: warm start for the scores of noisy copies. known: scores of the same object, if it has been scored.
    """
    others = assets.other_detectors(spec)
    start_from = nearby if candidate.method in SCORED_NEARBY else None
    radius_m = spec.attack.detection_radius_m
    scored = known or score_object(problem, candidate.code, candidate.theta, radius_m, others, start_from)
    # At reference accuracy the audit would compare the reference with itself.
    audited = candidate.method in AUDITED and problem.settings != REFERENCE
    return scored, audit(spec, assets, problem, candidate, scored) if audited else None


def audit(spec: TaskSpec, assets: Assets, problem: AttackProblem, candidate: Candidate, scored: ScoredObject) -> Audit:
    """Render some beams of a scored object again at reference accuracy. Source: our choice: the paper is silent."""
    start = time.perf_counter()
    rendering, theta = scored.measurement.rendering.first_hits, candidate.theta
    index = torch.from_numpy(_draw(spec, problem, candidate, rendering))
    beams = problem.cast_beams
    some = Beams(
        *(part[index] for part in (beams.points, beams.origins, beams.directions, beams.ranges_m, beams.carries))
    )
    with torch.no_grad():
        field = assets.decoder_of(REFERENCE.dtype).field(candidate.code.to(REFERENCE.dtype))
        truth = render(some, field, theta, problem.vehicle, REFERENCE)
    found = differences((rendering.hit_mask[index], rendering.range_m[index]), (truth.hit_mask, truth.range_m))
    return Audit(len(index), found, 1e3 * (time.perf_counter() - start))


def _draw(spec: TaskSpec, problem: AttackProblem, candidate: Candidate, rendering: Rendering) -> np.ndarray:
    """Draw up to 32 beams, int64, ascending: half of them hits, the others beams through the box without a hit."""
    rng = generator("audit", spec.placement_seed, candidate.method, candidate.replicate)
    box = Box(-problem.size_m / 2, problem.size_m / 2).grown(_MARGIN_M)
    near = rays_in_box(problem.cast_beams, candidate.theta, box).index.numpy()
    hits = rendering.hit_mask.nonzero().squeeze(1).numpy()
    others = np.setdiff1d(near, hits)
    parts = [rng.choice(pool, min(AUDITED_BEAMS // 2, len(pool)), replace=False) for pool in (hits, others)]
    return np.sort(np.concatenate(parts))
