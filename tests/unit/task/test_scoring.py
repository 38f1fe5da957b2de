"""Scores from the scene without the object: those of the whole scene, and none depends on another."""

import pytest
import torch
from short_tasks import make_spec

from shift3d.attack.baselines import noise_codes
from shift3d.seeding import generator
from shift3d.task.assets import Assets
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.scoring import EmptyScene, score_object
from shift3d.task.spec import PlacementSpec


def test_scored_from_the_empty_scene(assets: Assets) -> None:
    spec = make_spec(placement=PlacementSpec(max_range_m=25.0))
    problem = build_problem(spec, assets, place_vehicle(spec, assets).theta)  # type: ignore[union-attr]
    codes = noise_codes(problem.code0, 0.02, 2, generator("test", "noise"))

    def answer(code: torch.Tensor, scene: EmptyScene | None) -> tuple[float, float]:
        found = score_object(problem, code, problem.theta0, 5.0, scene=scene).answers["pointpillars"]
        return found.score, found.adversarial_loss

    scene = EmptyScene()
    forwards = [answer(code, scene) for code in codes]
    assert forwards[0] != forwards[1]
    assert answer(codes[1], EmptyScene()) == forwards[1] and answer(codes[0], scene) == forwards[0]
    assert forwards[0] == pytest.approx(answer(codes[0], None), rel=1e-4)
