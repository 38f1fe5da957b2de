"""Scores: from the scene without the object they equal those of the whole scene; none depends on another box."""

from collections import OrderedDict
from dataclasses import replace

import numpy as np
import pytest
import torch
from short_tasks import make_spec

from shift3d.attack.baselines import noise_codes
from shift3d.detectors.base import BevWindow, Proposals
from shift3d.scenes.scene import Labels
from shift3d.seeding import generator
from shift3d.task.assets import Assets
from shift3d.task.follow_ups.vehicle_pool import PoolAssets, overlap_score, pool_task, reconstructor_of
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.scoring import NoisyCopyScorer, score_box, score_object
from shift3d.task.spec import PlacementSpec

OBJECT = np.array([20.0, 3.0, 0.8, 4.5, 1.8, 1.5, 0.3])


class WholeScene:
    """Detector that gives the same proposals for any window, like a user's own detector."""

    name = "whole"

    def __init__(self, boxes: np.ndarray, scores: np.ndarray) -> None:
        logits = torch.logit(torch.from_numpy(scores))
        self.found = Proposals(torch.from_numpy(boxes).float(), logits, torch.arange(len(boxes)))

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        return BevWindow(0, 0, 1, 1, 0, 0, 1, 1)

    def proposals(self, points: torch.Tensor, window: BevWindow | None = None) -> Proposals:
        return self.found


def better_boxes(where: str) -> np.ndarray:
    """Return boxes that do not touch the object's: in one place, or apart, in numbers that exhaust suppression."""
    if where == "one place":
        return np.tile(OBJECT + np.array([9.0, 0, 0, 0, 0, 0, 0]), (5000, 1))
    x, y = (part.reshape(-1) for part in np.meshgrid(np.arange(-18, 18, 1.2), np.arange(-18, 18, 1.2)))
    far = np.hypot(x, y) > 8.0
    places = np.tile([0.0, 0.0, 0.8, 1.0, 1.0, 1.5, 0.0], (int(far.sum()), 1))
    places[:, :2] = np.column_stack((x, y))[far] + OBJECT[:2] + ((0.0, 0.0) if where == "apart" else (60.0, 0.0))
    return places


@pytest.mark.parametrize("where", ["one place", "apart", "far away"])
def test_a_low_score_is_its_own_however_many_boxes_elsewhere_score_higher(where: str) -> None:
    others = better_boxes(where)
    boxes, scores = np.concatenate((others, OBJECT[None])), np.append(np.full(len(others), 0.1), 0.05)
    detector = WholeScene(boxes, scores)
    found = score_box(torch.zeros(1, 3), OBJECT, 0.0, 5.0, {"whole": detector})["whole"]  # type: ignore[dict-item]
    assert found.score == pytest.approx(0.05)
    assert overlap_score(detector.found, OBJECT) == pytest.approx(0.05)


def test_a_box_that_the_detector_never_reports_is_no_score() -> None:
    """A box next to the peak of a heat map, for example, is never reported."""
    beside = OBJECT + np.array([0.3, 0, 0, 0, 0, 0, 0])
    detector = WholeScene(np.stack((beside, OBJECT)), np.array([0.07, 0.05]))
    detector.found = replace(detector.found, reported=torch.tensor([False, True]))
    found = score_box(torch.zeros(1, 3), OBJECT, 0.0, 5.0, {"whole": detector})["whole"]  # type: ignore[dict-item]
    assert found.score == pytest.approx(0.05)


def test_no_box_and_a_box_that_is_no_number_are_no_score() -> None:
    for boxes in (np.zeros((0, 7)), OBJECT[None]):
        detector = WholeScene(boxes, np.full(len(boxes), np.nan))
        found = score_box(torch.zeros(1, 3), OBJECT, 0.0, 5.0, {"whole": detector})["whole"]  # type: ignore[dict-item]
        assert found.score == 0.0 and overlap_score(detector.found, OBJECT) == 0.0


def test_a_vehicle_of_a_pool_beyond_the_detectors_grid_is_refused_and_not_missed(assets: Assets) -> None:
    """Both vehicles have points enough for a fit. The network has cells up to 74.88 m."""
    spec = make_spec()
    scene, beams = assets.scene(spec)
    boxes = np.stack([OBJECT + np.array([dx, 0, scene.ground_z_m, 0, 0, 0, 0]) for dx in (50.0, 56.0)])
    points = scene.points.copy()
    there = np.random.default_rng(0).uniform(-0.3, 0.3, (2, 200, 3)) * OBJECT[3:6] + boxes[:, None, :3]
    points[np.flatnonzero(scene.has_beam)[:400]] = there.reshape(-1, 3)
    seen = replace(scene, points=points, labels=Labels(boxes, ("vehicle",) * 2, np.zeros(2, np.int32)))
    held = replace(assets, _scenes=OrderedDict({spec.scene: (seen, beams, "")}))
    found = pool_task(spec, PoolAssets(held, reconstructor_of(assets.vehicles))).vehicle_pool
    assert [row["status"] for row in found] == ["fitted", "beyond_grid"]


def test_a_box_centred_beyond_the_radius_still_suppresses() -> None:
    longer = OBJECT.copy()
    longer[:2] += 5.5 * np.cos(OBJECT[6]), 5.5 * np.sin(OBJECT[6])
    longer[3] = 16.0
    detector = WholeScene(np.stack((OBJECT, longer)), np.array([0.05, 0.1]))
    found = score_box(torch.zeros(1, 3), OBJECT, 0.0, 5.0, {"whole": detector})["whole"]  # type: ignore[dict-item]
    assert found.score == 0.0


def test_scored_nearby_is_scored_afresh_for_less(assets: Assets) -> None:
    spec = make_spec(placement=PlacementSpec(max_range_m=25.0))
    problem = build_problem(spec, assets, place_vehicle(spec, assets).theta)  # type: ignore[union-attr]
    solution, *codes = noise_codes(problem.code0, 0.02, 3, generator("test", "noise"))
    first = score_object(problem, solution, problem.theta0, 5.0)

    def answer(code: torch.Tensor, nearby: NoisyCopyScorer | None) -> tuple[float, float, int]:
        found = score_object(problem, code, problem.theta0, 5.0, nearby=nearby)
        one = found.results["pointpillars"]
        return one.score, one.adversarial_loss, found.measurement.rendering.evaluations

    def start() -> NoisyCopyScorer:
        nearby = NoisyCopyScorer()
        nearby.note("adversarial", first)
        return nearby

    nearby = start()
    there = [answer(code, nearby) for code in codes]
    assert there[0] != there[1]
    assert answer(codes[1], start()) == there[1] and answer(codes[0], nearby) == there[0]
    afresh = answer(codes[0], None)
    assert there[0][:2] == pytest.approx(afresh[:2], rel=1e-4) and there[0][2] < 0.7 * afresh[2]
