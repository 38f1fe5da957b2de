"""The truth that errors are measured against: stored on disk without loss, and scored like a task's scene."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from attack_by_hand import CODE, THETA, small_problem

from shift3d.accuracy_time.errors import TrueHits
from shift3d.accuracy_time.truth import SHAPES, Truth, read_truth, score_of, write_truth
from shift3d.task.scoring import score_object


def test_a_truth_read_back_is_the_one_that_was_written(tmp_path: Path) -> None:
    rng = torch.Generator().manual_seed(0)

    def floats(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=rng, dtype=torch.float64)

    hits = {shape: TrueHits(torch.tensor([1, 5, 9]), floats(3), floats(3)) for shape in SHAPES}
    codes = {shape: floats(6) for shape in SHAPES}
    truth = Truth(codes, hits, {"start": 0.1 / 3, "displaced": 0.7}, {"start": 0, "displaced": 2}, floats(6), floats(6))
    write_truth(tmp_path / "deep" / "truth.npz", truth)
    found = read_truth(tmp_path / "deep" / "truth.npz")
    assert (found.scores, found.unresolved) == (truth.scores, truth.unresolved)
    assert torch.equal(found.dz, truth.dz) and torch.equal(found.dtheta, truth.dtheta)
    for shape in SHAPES:
        assert torch.equal(found.codes[shape], truth.codes[shape])
        for name in ("index", "range_m", "chord_m"):
            assert torch.equal(getattr(found.hits[shape], name), getattr(truth.hits[shape], name))


def test_the_score_is_the_one_that_tasks_report() -> None:
    problem = small_problem()
    scored = score_object(problem, CODE, THETA, radius_m=5.0)
    again = score_of(problem, problem.detector, scored.measurement.rendering, 12.0, 5.0)
    assert again == scored.results["wave"].score > 0


def test_a_score_needs_a_box_near_the_object() -> None:
    problem = small_problem()
    rendering = score_object(problem, CODE, THETA, 5.0).measurement.rendering
    assert score_of(problem, problem.detector, rendering, 12.0, radius_m=1e-9) == 0.0
    whole = score_of(problem, problem.detector, rendering, None, 5.0)
    assert whole == pytest.approx(score_of(problem, problem.detector, rendering, 12.0, 5.0), abs=1e-6)
