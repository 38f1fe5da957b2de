"""The paper's choice of lambda."""

from __future__ import annotations

import pytest

from shift3d.sweep.lambda_rule import select_lambda


@pytest.mark.parametrize(
    ("losses", "chosen"),
    [
        ({1.0: 0.5, 10.0: 0.9}, 1.0),  # clearly lower
        ({1.0: 0.9, 10.0: 0.5}, 10.0),
        ({1.0: 1.0, 10.0: 1.049}, 10.0),  # within 5 %: the larger one
        ({1.0: 1.0, 10.0: 1.051}, 1.0),
        ({1.0: 0.0, 10.0: 0.009}, 10.0),  # near zero, within 0.01
        ({0.1: 1.0, 1.0: 1.04, 10.0: 2.0}, 1.0),
        ({3.0: 7.0}, 3.0),
    ],
)
def test_lowest_loss_or_the_larger_lambda_when_nearly_equal(losses: dict[float, float], chosen: float) -> None:
    assert select_lambda(losses) == chosen


def test_nothing_to_choose_from() -> None:
    with pytest.raises(ValueError):
        select_lambda({})
