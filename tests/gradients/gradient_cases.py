"""What every gradient test shares: a loss on points, its central differences, the accuracy they need."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from shift3d.render import Beams, Rendering, preset

# Roots to 1e-13 m, so that differences over 1e-6 still carry six digits. No floor: the paper's formula.
EXACT = preset("reference").with_(step_m=0.02, max_step_m=0.1, tolerance_m=1e-13, max_iterations=200, grazing_floor=0.0)


def wavy_loss(points: Tensor) -> Tensor:
    """A smooth loss that weighs every coordinate of every point differently."""
    weight = torch.tensor([0.7, -1.1, 1.9], dtype=points.dtype)
    return torch.sin(points @ weight + points.square().sum(-1) * 0.05).sum()


def analytic(draw: Callable[[Tensor], Rendering], at: Tensor) -> tuple[Tensor, Rendering]:
    """dL/dv in one backward pass."""
    variable = at.clone().requires_grad_()
    rendering = draw(variable)
    wavy_loss(rendering.points).backward()
    assert variable.grad is not None
    return variable.grad, rendering


def differences(
    draw: Callable[[Tensor], Rendering], at: Tensor, step: float, rows: Tensor | None = None
) -> tuple[Tensor, bool]:
    """Central differences of the loss under a full re-render, and whether the hit set held throughout."""
    held, hits = True, draw(at).hit_mask
    result = torch.zeros_like(at)
    for i in range(len(at)):
        if rows is not None and i not in rows:
            continue
        values = []
        for sign in (1.0, -1.0):
            moved = at.clone()
            moved[i] += sign * step
            rendering = draw(moved)
            held &= torch.equal(rendering.hit_mask, hits)
            values.append(float(wavy_loss(rendering.points)))
        result[i] = (values[0] - values[1]) / (2.0 * step)
    return result, held


def relative_error(found: Tensor, expected: Tensor) -> float:
    return float((found - expected).norm() / expected.norm())


def select(beams: Beams, rows: Tensor) -> Beams:
    """Some of the beams."""
    return Beams(
        beams.points[rows], beams.origins[rows], beams.directions[rows], beams.ranges_m[rows], beams.carries[rows]
    )
