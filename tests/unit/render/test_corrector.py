"""From predicted hits to hits: roots of closed forms, and none if none is within reach."""

import pytest
import torch
from analytic_fields import Field, box, sphere
from straight_rays import FLOAT64, along_x, field_of
from torch import Tensor

from shift3d.render.field.linearization import linearize
from shift3d.render.solvers.corrector import correct, predict

OFFSETS = (0.0, 0.2, -0.4, 0.6, 0.8)
RAYS = along_x(*OFFSETS)
ENTRY = 3.0 - (1.0 - torch.tensor(OFFSETS, dtype=torch.float64) ** 2).sqrt()
EVALUATED = FLOAT64.with_(tolerance_m=1e-9, final_newton_m=0.0)


def by_secant(start: Tensor, metric: Field, reach_m: float = 0.3) -> Tensor:
    slope = torch.full_like(start, -0.5)
    return correct(RAYS, start, slope, field_of(metric), EVALUATED, reach_m).range_m


@pytest.mark.parametrize("off_m", [-0.03, -1e-3, 0.0, 1e-3, 0.03])
def test_both_reach_the_root_from_a_prediction_nearby(off_m: float) -> None:
    secants = by_secant(ENTRY + off_m, sphere(1.0))
    steps = FLOAT64.with_(final_newton_m=1e-3)
    found = correct(RAYS, ENTRY + off_m, None, field_of(sphere(1.0)), steps, 0.3)
    at = found.linearizations
    assert at is not None
    assert torch.isfinite(secants).double().mean() >= 0.8
    assert float((secants - ENTRY).abs().nan_to_num(0.0).max()) < 2e-8
    assert torch.isfinite(found.range_m).all() and float((found.range_m - ENTRY).abs().max()) <= 1.1e-3
    assert torch.equal(at.index, RAYS.index) and torch.equal(at.range_m, found.range_m)
    assert torch.allclose(found.g_start, sphere(1.0)(RAYS.at(ENTRY + off_m)), atol=1e-12)


def test_a_last_step_that_is_short_is_not_evaluated() -> None:
    field = field_of(sphere(1.0))
    found = correct(RAYS, ENTRY - 5e-4, torch.full_like(ENTRY, -1.0), field, FLOAT64.with_(final_newton_m=1e-3), 0.3)
    assert field.count.evaluations == len(RAYS)
    assert float((found.range_m - ENTRY).abs().max()) < 5e-4 and float(found.residual_m.max()) < 6e-4


def test_what_is_gone_or_beyond_reach_is_lost() -> None:
    assert torch.isnan(by_secant(ENTRY, sphere(0.5, (0.0, 5.0, 0.0)))).all()
    assert torch.isnan(by_secant(ENTRY - 0.5, sphere(1.0), reach_m=0.3)).all()
    for start in (ENTRY - 0.5, torch.full_like(ENTRY, 4.9)):  # too far, and on the way out
        found = correct(RAYS, start, None, field_of(sphere(1.0)), FLOAT64, 0.05)
        assert torch.isnan(found.range_m).all() and found.linearizations is not None
        assert len(found.linearizations) == 0


def test_a_nan_is_no_root() -> None:
    nowhere = lambda x: x[:, 0] * torch.nan  # noqa: E731
    assert torch.isnan(by_secant(ENTRY, nowhere)).all()
    assert torch.isnan(correct(RAYS, ENTRY, None, field_of(nowhere), FLOAT64, 0.3).range_m).all()


def test_a_plane_that_rays_have_moved_along_is_predicted_exactly() -> None:
    block = field_of(box((1.0, 3.0, 1.0)))
    before = linearize(block, RAYS, torch.full_like(ENTRY, 2.01))
    moved = along_x(*(offset + 0.05 for offset in OFFSETS), start=-2.9)
    expected, change = predict(before, moved, block)
    assert torch.allclose(expected, torch.full_like(ENTRY, 1.9), atol=1e-12)
    assert torch.allclose(change, torch.full_like(ENTRY, -0.1), atol=1e-12)
