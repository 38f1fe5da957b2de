"""Root finding in brackets, many beams at once: Anderson and Björck's regula falsi (BIT 13, 1973) with bisection
whenever three steps have not halved the bracket.

Plain Illinois leaves outliers. Bisection gains one bit a step. ITP (Oliveira & Takahashi 2020) pushes its first steps
towards the middle, which costs an evaluation on fields that are nearly linear along a short bracket.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Roots:
    """Roots of M functions: k (M,), |g| at k (M,), converged (M,) bool. |g| is NaN if g was not always finite."""

    k: Tensor
    residual: Tensor
    converged: Tensor


def find_roots(
    g: Callable[[Tensor, Tensor], Tensor],
    outer: Tensor,
    inner: Tensor,
    g_outer: Tensor,
    g_inner: Tensor,
    tolerance: float,
    max_iterations: int,
) -> Roots:
    """Find roots of g between outer (g >= 0) and inner (g < 0).

    Args:
        g: takes ranges (m,) and the rows (m,) that they belong to, returns (m,).
        outer, inner: (M,) float64 ends of the brackets. outer < inner is not required.
        g_outer, g_inner: (M,) values at the ends.
        tolerance: |g| at which a root is accepted. max_iterations: most evaluations per row.
    Returns:
        Roots. A bracket that has shrunk to 1e-12 of its position counts as converged: in float32 no better |g| exists
            there, and the residual states what was reached. If the outer end is an exact root it is returned.
    Source: our choice: the paper bisects.
    """
    a, b, ga, gb = outer, inner, g_outer.double(), g_inner.double()
    best_k, residual = torch.where(ga.abs() <= gb.abs(), a, b), torch.minimum(ga.abs(), gb.abs())
    residual = torch.where(torch.isfinite(ga) & torch.isfinite(gb), residual, torch.nan)
    # From here on for unfinished rows only. last: end replaced last, 1 a, -1 b; slow: steps since the bracket halved.
    rows = torch.nonzero(residual > tolerance).squeeze(1)
    a, b, ga, gb = (part[rows] for part in (a, b, ga, gb))
    last, slow, width = torch.zeros_like(rows), torch.zeros_like(rows), (b - a).abs()
    for _ in range(max_iterations):
        if len(rows) == 0:
            break
        share = (ga / (ga - gb)).nan_to_num(0.5, 0.5, 0.5).clamp(0.01, 0.99)
        k = a + torch.where(slow >= 3, 0.5, share) * (b - a)
        value = g(k, rows).double()
        better = ~(value.abs() > residual[rows])  # also if it is NaN
        best_k[rows[better]], residual[rows[better]] = k[better], value[better].abs()
        inside = value < 0
        # The value at an end that stays a second time is weighted down.
        ga, gb = (
            torch.where(inside & (last == -1), ga * _weight(value, gb), ga),
            torch.where(~inside & (last == 1), gb * _weight(value, ga), gb),
        )
        a, ga = torch.where(inside, a, k), torch.where(inside, ga, value)
        b, gb = torch.where(inside, k, b), torch.where(inside, value, gb)
        last, new_width = torch.where(inside, -1, 1), (b - a).abs()
        halved = new_width <= 0.5 * width
        slow, width = torch.where(halved, 0, slow + 1), torch.where(halved, new_width, width)
        going = (residual[rows] > tolerance) & (new_width > 1e-12 * (1.0 + k.abs()))
        rows, a, b, ga, gb, last, slow, width = (part[going] for part in (rows, a, b, ga, gb, last, slow, width))
    converged = torch.isfinite(residual)
    converged[rows] = False
    return Roots(best_k, residual, converged)


def _weight(value: Tensor, replaced: Tensor) -> Tensor:
    """Return Anderson and Björck's weight for the end that stays; Illinois's half if their weight is not positive."""
    weight = 1.0 - value / torch.where(replaced == 0, 1.0, replaced)
    return torch.where(weight > 0, weight, 0.5)
