"""The audit counts errors of a rendering: the tests insert faults, and the audit must find each of them."""

from dataclasses import replace

import pytest
import torch
from short_tasks import make_spec

from shift3d.attack.problem import AttackProblem
from shift3d.render import render
from shift3d.render.settings import REFERENCE
from shift3d.task.assets import Assets
from shift3d.task.audit import AUDITED_BEAMS, audit
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.scoring import Candidate, ScoredObject, score_object
from shift3d.task.spec import AttackSpec, TaskSpec


@pytest.fixture(scope="module")
def case(assets: Assets) -> tuple[TaskSpec, AttackProblem, Candidate, ScoredObject]:
    spec = make_spec(attack=AttackSpec(steps=1))
    placement = place_vehicle(spec, assets)
    problem = build_problem(spec, assets, placement.theta)  # type: ignore[union-attr]
    candidate = Candidate("baseline", 0, problem.code0, problem.theta0)
    scored = score_object(problem, candidate.code, candidate.theta, 5.0)
    # The truth replaces the rendering: the audit can find only inserted faults.
    with torch.no_grad():
        field = assets.decoder_of(torch.float64).field(problem.code0.double())
        truth = render(problem.beams, field, problem.theta0, problem.vehicle, REFERENCE)
    return spec, problem, candidate, replace(scored, measurement=replace(scored.measurement, rendering=truth))


def changed(scored: ScoredObject, **parts: torch.Tensor) -> ScoredObject:
    rendering = replace(scored.measurement.rendering, **parts)
    return replace(scored, measurement=replace(scored.measurement, rendering=rendering))


def test_a_true_rendering_has_no_error(
    assets: Assets, case: tuple[TaskSpec, AttackProblem, Candidate, ScoredObject]
) -> None:
    spec, problem, candidate, scored = case
    found = audit(spec, assets, problem, candidate, scored)
    assert found.audited_beams == AUDITED_BEAMS and found.found.hits == AUDITED_BEAMS // 2
    assert (found.found.missed_hits, found.found.false_hits, found.found.wrong_surface) == (0, 0, 0)
    assert found.found.depth_error_max_m < 1e-9
    assert audit(spec, assets, problem, candidate, scored).columns() == found.columns()


def test_a_depth_that_is_off_is_measured(
    assets: Assets, case: tuple[TaskSpec, AttackProblem, Candidate, ScoredObject]
) -> None:
    spec, problem, candidate, scored = case
    ranges = scored.measurement.rendering.range_m
    found = audit(spec, assets, problem, candidate, changed(scored, range_m=ranges + 0.004))
    assert found.found.depth_error_max_m == pytest.approx(0.004, abs=1e-9) and found.found.wrong_surface == 0
    found = audit(spec, assets, problem, candidate, changed(scored, range_m=ranges + 0.02))
    assert found.found.wrong_surface == found.found.hits and found.found.depth_error_max_m == 0.0


def test_lost_and_invented_hits_are_counted(
    assets: Assets, case: tuple[TaskSpec, AttackProblem, Candidate, ScoredObject]
) -> None:
    spec, problem, candidate, scored = case
    hits = scored.measurement.rendering.hit_mask
    everything = audit(spec, assets, problem, candidate, changed(scored, hit_mask=torch.ones_like(hits)))
    # Beams are drawn among reported hits: only some of them are true hits.
    assert everything.found.false_hits == everything.audited_beams - everything.found.hits > 0
    nothing = audit(spec, assets, problem, candidate, changed(scored, hit_mask=torch.zeros_like(hits)))
    assert nothing.found.missed_hits == nothing.found.hits > 0 and nothing.found.false_hits == 0
