"""ITP inside a bracket, many beams at once, and the bisection that it never takes more than one evaluation longer than.

ITP takes the point of regula falsi, moves it a little towards the middle, and holds it to an interval around the
middle that leaves every later bracket as short as bisection with one evaluation to spare would have it. Priced beside
the default (see `roots`); in the renderer's short brackets, where fields are nearly linear, that one wins.

Source: Oliveira & Takahashi, An Enhancement of the Bisection Method Average Performance Preserving Minmax Optimality,
ACM TOMS 47 (2020), Algorithm 1 with k1 = 0.2 / bracket, k2 = 2, n0 = 1, the values they recommend.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from shift3d.render.roots import Roots

SLACK = 1
"""n0: evaluations that ITP may take beyond bisection's."""
_POINT = 1e-12

Function = Callable[[Tensor, Tensor], Tensor]


def find_roots_itp(
    g: Function, outer: Tensor, inner: Tensor, g_outer: Tensor, g_inner: Tensor, tolerance: float, max_iterations: int
) -> Roots:
    """Roots between outer (g >= 0) and inner (g < 0) by ITP; arguments and result as of `roots.find_roots`.

    A bracket that has shrunk to `tolerance` counts as settled too: the place is then known as well as the value is
    asked for. So no row takes more than ceil(log2(bracket / tolerance)) + 1 evaluations.
    """
    return _narrow(g, outer, inner, g_outer, g_inner, tolerance, max_iterations, interpolate=True)


def find_roots_bisection(
    g: Function, outer: Tensor, inner: Tensor, g_outer: Tensor, g_inner: Tensor, tolerance: float, max_iterations: int
) -> Roots:
    """The same by bisection: ceil(log2(bracket / tolerance)) evaluations at most."""
    return _narrow(g, outer, inner, g_outer, g_inner, tolerance, max_iterations, interpolate=False)


def _narrow(
    g: Function,
    outer: Tensor,
    inner: Tensor,
    g_outer: Tensor,
    g_inner: Tensor,
    tolerance: float,
    max_iterations: int,
    interpolate: bool,
) -> Roots:
    """Brackets are halved, or better, until |g| at an end or the bracket itself is within the tolerance.

    A row on which g is not finite is given up.
    """
    a, b = outer.double().clone(), inner.double().clone()
    ga, gb = g_outer.double().clone(), g_inner.double().clone()
    first_width = (b - a).abs()
    least = max(tolerance, _POINT)
    most = torch.log2((first_width / least).clamp_min(1.0)).ceil() + SLACK
    lost = ~(torch.isfinite(ga) & torch.isfinite(gb))
    rows = torch.nonzero((torch.minimum(ga.abs(), gb.abs()) > tolerance) & (first_width > tolerance) & ~lost).squeeze(1)
    for count in range(max_iterations):
        if len(rows) == 0:
            break
        ends = a[rows], b[rows], ga[rows], gb[rows]
        half = 0.5 * (ends[0] + ends[1])
        # Half the length that the bracket may have left after this evaluation and all that follow.
        allowed = 0.5 * least * torch.exp2(most[rows] - count)
        k = _itp_point(*ends, half, allowed, first_width[rows]) if interpolate else half
        value = g(k, rows).double()
        lost[rows] = ~torch.isfinite(value)
        inside = value < 0
        a[rows], ga[rows] = torch.where(inside, ends[0], k), torch.where(inside, ends[2], value)
        b[rows], gb[rows] = torch.where(inside, k, ends[1]), torch.where(inside, value, ends[3])
        short = (b - a).abs()[rows] <= tolerance + _POINT * (1.0 + k.abs())
        rows = rows[~(short | (value.abs() <= tolerance) | lost[rows])]
    settled = ~lost
    settled[rows] = False
    better = ga.abs() <= gb.abs()
    residual = torch.where(better, ga.abs(), gb.abs()).masked_fill(lost, torch.nan)
    return Roots(torch.where(better, a, b), residual, settled)


def _itp_point(
    a: Tensor, b: Tensor, ga: Tensor, gb: Tensor, half: Tensor, allowed: Tensor, first_width: Tensor
) -> Tensor:
    """Interpolate, truncate towards the middle, project to what keeps the promise."""
    width = (b - a).abs()
    share = ga / (ga - gb)
    straight = a + torch.where(torch.isfinite(share), share, 0.5) * (b - a)
    towards = torch.sign(half - straight)
    shift = 0.2 * width.square() / first_width
    truncated = torch.where(shift <= (half - straight).abs(), straight + towards * shift, half)
    reach = (allowed - 0.5 * width).clamp_min(0.0)
    return torch.where((truncated - half).abs() <= reach, truncated, half - towards * reach)
