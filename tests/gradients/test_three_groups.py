"""Every gradient against central differences of a full re-rendering, each with its own step and tolerance."""

import pytest
import torch
from gradient_cases import GradientCase, observed_orders
from gradient_catalogue import AT_TEN, at_the_posts_edge, discontinuous_cases, silhouette_cases, smooth_cases


def named(cases: list[GradientCase]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("case", cases, ids=lambda case: case.name)


@named(smooth_cases())
def test_smooth(case: GradientCase) -> None:
    errors, extrapolated = case.errors(halvings=2)
    assert errors[0] < case.tolerance
    # Second order: the error is that of the third derivative alone.
    assert all(abs(order - 2.0) < 0.2 for order in observed_orders(errors)), errors
    # Without that term the remaining error is of fourth order.
    assert extrapolated < errors[-1] / 20


@named(silhouette_cases())
def test_moving_silhouette(case: GradientCase) -> None:
    assert _error(case) < case.tolerance


@named(discontinuous_cases())
def test_discontinuous(case: GradientCase) -> None:
    assert _error(case) < case.tolerance


def _error(case: GradientCase) -> float:
    expected = case.differences(case.step)
    return float((case.gradient() - expected).norm() / expected.norm())


def test_a_step_across_the_jump_sees_its_height_and_the_gradient_does_not() -> None:
    """The derivative is that of the beam's own side: like the paper, it leaves out the contribution of a jump."""
    loss, step = at_the_posts_edge(-1e-4), 1e-3
    aside = torch.tensor([0.0, step, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    ends = [loss(AT_TEN + sign * aside) for sign in (1.0, -1.0)]
    assert [bool(end[1]) for end in ends] == [True, False]
    across = float(ends[0][0] - ends[1][0]) / (2 * step)
    theta = AT_TEN.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(theta)[0], theta)
    assert abs(across) > 100 * abs(float(gradient[1])) + 100
