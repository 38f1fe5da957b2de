"""Scores from the scene without the object: those of the whole scene, and none depends on another."""

import pytest
import torch
from short_tasks import make_spec

from shift3d.attack.baselines import noise_codes
from shift3d.seeding import generator
from shift3d.task.assets import Assets
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.scoring import Nearby, score_object
from shift3d.task.spec import PlacementSpec


def test_scored_nearby_is_scored_afresh_for_less(assets: Assets) -> None:
    spec = make_spec(placement=PlacementSpec(max_range_m=25.0))
    problem = build_problem(spec, assets, place_vehicle(spec, assets).theta)  # type: ignore[union-attr]
    solution, *codes = noise_codes(problem.code0, 0.02, 3, generator("test", "noise"))
    first = score_object(problem, solution, problem.theta0, 5.0)

    def answer(code: torch.Tensor, nearby: Nearby | None) -> tuple[float, float, int]:
        found = score_object(problem, code, problem.theta0, 5.0, nearby=nearby)
        one = found.answers["pointpillars"]
        return one.score, one.adversarial_loss, found.measurement.rendering.evaluations

    def start() -> Nearby:
        nearby = Nearby()
        nearby.note("adversarial", first)
        return nearby

    nearby = start()
    there = [answer(code, nearby) for code in codes]
    assert there[0] != there[1]
    assert answer(codes[1], start()) == there[1] and answer(codes[0], nearby) == there[0]
    afresh = answer(codes[0], None)
    assert there[0][:2] == pytest.approx(afresh[:2], rel=1e-4) and there[0][2] < 0.7 * afresh[2]
