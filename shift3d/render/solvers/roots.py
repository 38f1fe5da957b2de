"""Root finding inside a bracket, many beams at once.

The method is Anderson and Björck's regula falsi (Anderson & Björck, BIT 13, 1973) with a bisection whenever
three steps have not halved the bracket. It was chosen over plain Illinois (leaves outliers), bisection
(one bit a step) and ITP (Oliveira & Takahashi 2020: the same worst case, but its first steps are pushed
towards the middle, which costs an evaluation on fields that are nearly linear along a short bracket).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Roots:
    """Roots of M functions: k (M,), |g| there (M,), and whether the tolerance was met (M,) bool.

    Where a function was not finite on the way nothing is converged and |g| is NaN.
    """

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
    """Roots of g between outer (g >= 0) and inner (g < 0).

    Args:
        g: takes ranges (m,) and the rows (m,) they belong to, returns (m,).
        outer, inner: (M,) float64 ends of the brackets. outer < inner is not required.
        g_outer, g_inner: (M,) values there.
        tolerance: |g| at which a root is taken.
        max_iterations: evaluations a row at most.

    Returns:
        Roots. A bracket that has shrunk to 1e-12 of its position counts as converged: in float32 no better
        |g| exists there, and the residual says what was reached. If the outer end is an exact root it is
        the answer.

    Source: our choice: the paper bisects.
    """
    slow = torch.zeros(len(outer), dtype=torch.int8)
    state = _Brackets(outer.clone(), inner.clone(), g_outer.double().clone(), g_inner.double().clone(), slow.clone())
    best_k = torch.where(state.ga.abs() <= state.gb.abs(), state.a, state.b)
    best_g = torch.minimum(state.ga.abs(), state.gb.abs())
    width = (state.b - state.a).abs()
    lost = ~(torch.isfinite(state.ga) & torch.isfinite(state.gb))
    rows = torch.nonzero((best_g > tolerance) & ~lost).squeeze(1)
    for _ in range(max_iterations):
        if len(rows) == 0:
            break
        k = state.propose(rows, slow[rows] >= 3)
        value = g(k, rows).double()
        lost[rows] = ~torch.isfinite(value)
        state.update(rows, k, value)
        better = value.abs() <= best_g[rows]
        best_k[rows] = torch.where(better, k, best_k[rows])
        best_g[rows] = torch.where(better, value.abs(), best_g[rows])
        new_width = (state.b - state.a).abs()[rows]
        halved = new_width <= 0.5 * width[rows]
        slow[rows] = torch.where(halved, 0, slow[rows] + 1).to(torch.int8)
        width[rows] = torch.where(halved, new_width, width[rows])
        point = new_width <= 1e-12 * (1.0 + k.abs())
        rows = rows[(best_g[rows] > tolerance) & ~point & ~lost[rows]]
    converged = ~lost
    converged[rows] = False
    return Roots(best_k, best_g.masked_fill(lost, torch.nan), converged)


@dataclass
class _Brackets:
    """Ends a (outside) and b (inside) with their values; `last` is the end replaced last (1 a, -1 b, 0 none)."""

    a: Tensor
    b: Tensor
    ga: Tensor
    gb: Tensor
    last: Tensor

    def propose(self, rows: Tensor, bisect: Tensor) -> Tensor:
        """The next position of each row: on the line through both ends, or in the middle."""
        a, b, ga, gb = self.a[rows], self.b[rows], self.ga[rows], self.gb[rows]
        share = ga / (ga - gb)
        share = torch.where(torch.isfinite(share), share, 0.5).clamp(0.01, 0.99)
        return a + torch.where(bisect, 0.5, share) * (b - a)

    def update(self, rows: Tensor, k: Tensor, value: Tensor) -> None:
        """Replace one end. If it is the same end as last time, weigh the other one down."""
        a, b, ga, gb = self.a[rows], self.b[rows], self.ga[rows], self.gb[rows]
        inside, last = value < 0, self.last[rows]
        weight_a = torch.where(inside & (last == -1), _weight(value, gb), 1.0)
        weight_b = torch.where(~inside & (last == 1), _weight(value, ga), 1.0)
        self.a[rows] = torch.where(inside, a, k)
        self.b[rows] = torch.where(inside, k, b)
        self.ga[rows] = torch.where(inside, ga * weight_a, value)
        self.gb[rows] = torch.where(inside, value, gb * weight_b)
        self.last[rows] = torch.where(inside, -1, 1).to(torch.int8)


def _weight(value: Tensor, replaced: Tensor) -> Tensor:
    """Anderson and Bjoerck's weight of the end that stays; Illinois's half where theirs is not positive."""
    weight = 1.0 - value / torch.where(replaced == 0, 1.0, replaced)
    return torch.where(weight > 0, weight, 0.5)
