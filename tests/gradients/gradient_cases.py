"""Parts of every gradient test: a loss on points, its central differences, and the accuracy that they need.

Cases come in three groups, by the change of the hits. `smooth`: every beam stays well inside the silhouette, so that
the loss is smooth over the case's step and the error of central differences falls with its square. `moving silhouette`:
grazing beams are included; the set of hits is constant over very small steps alone. `discontinuous`: something jumps
near by (the hit to another surface, a point to another pillar, a slope at a ReLU's switch), and the derivative is that
of the beam's own side.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from shift3d.render import Beams, Rendering, preset

# Roots to 1e-13 m, so that differences over 1e-6 still have six digits. Without a floor: the paper's formula.
EXACT = preset("reference").with_(step_m=0.02, max_step_m=0.1, tolerance_m=1e-13, max_iterations=200, min_n_dot_d=0.0)


def wavy_loss(points: Tensor) -> Tensor:
    """Return a smooth loss that weighs every coordinate of every point differently."""
    weight = torch.tensor([0.7, -1.1, 1.9], dtype=points.dtype)
    return torch.sin(points @ weight + points.square().sum(-1) * 0.05).sum()


def analytic(draw: Callable[[Tensor], Rendering], at: Tensor) -> tuple[Tensor, Rendering]:
    """Compute dL/dv in one backward pass."""
    variable = at.clone().requires_grad_()
    rendering = draw(variable)
    wavy_loss(rendering.points).backward()
    assert variable.grad is not None
    return variable.grad, rendering


def relative_error(found: Tensor, expected: Tensor) -> float:
    return float((found - expected).norm() / expected.norm())


def select(beams: Beams, rows: Tensor) -> Beams:
    """Return some of the beams."""
    return Beams(
        beams.points[rows], beams.origins[rows], beams.directions[rows], beams.ranges_m[rows], beams.carries[rows]
    )


Group = Literal["smooth", "moving silhouette", "discontinuous"]


@dataclass(frozen=True)
class GradientCase:
    """A loss of a variable through a full re-rendering, and the check of its derivative.

    Attributes:
        loss: variable (D,) float64 -> (scalar loss, value that must stay constant over the step, such as the hit mask).
        at: (D,) place. step: of the central differences, in the variable's own units.
        tolerance: largest relative error of the gradient against central differences with that step.
        directions: (K, D) directions of the differences; None: every coordinate.
    """

    name: str
    group: Group
    loss: Callable[[Tensor], tuple[Tensor, Tensor]]
    at: Tensor
    step: float
    tolerance: float
    directions: Tensor | None = None

    def along(self) -> Tensor:
        """Return the directions (K, D)."""
        return torch.eye(len(self.at), dtype=torch.float64) if self.directions is None else self.directions

    def gradient(self) -> Tensor:
        """Compute the derivative along each direction (K,) in one backward pass."""
        variable = self.at.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(self.loss(variable)[0], variable)
        return self.along() @ gradient

    def differences(self, step: float) -> Tensor:
        """Compute central differences (K,); check that the constant quantity does not change."""
        result = []
        with torch.no_grad():
            held = self.loss(self.at)[1]
            for direction in self.along():
                ends = [self.loss(self.at + sign * step * direction) for sign in (1.0, -1.0)]
                assert all(torch.equal(end[1], held) for end in ends), f"{self.name}: a step of {step:g} is too long"
                result.append((ends[0][0] - ends[1][0]) / (2.0 * step))
        return torch.stack(result)

    def errors(self, halvings: int) -> tuple[list[float], float]:
        """Return relative errors for the step and its halves, and for the Richardson extrapolation of the last two."""
        gradient = self.gradient()
        found = [self.differences(self.step / 2**i) for i in range(halvings + 1)]
        extrapolated = (4.0 * found[-1] - found[-2]) / 3.0
        return [relative_error(gradient, part) for part in found], relative_error(gradient, extrapolated)


def observed_orders(errors: list[float]) -> list[float]:
    """Return log2 of the factor by which an error falls each time the step halves."""
    return [math.log2(before / after) for before, after in itertools.pairwise(errors)]
