"""Gradient of the loss through renderer and detector, timed by stage, and its comparison with the reference."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import torch
from torch import Tensor

from shift3d.attack.problem import AttackProblem, measure
from shift3d.detectors.incremental.inference import IncrementalInference
from shift3d.render.rendering import Rendering
from shift3d.render.solvers.search import WarmStart


@dataclass(frozen=True)
class AttackStep:
    """One attack step: rendering, detector, constraints, and backward pass.

    loss: value of the adversarial loss. dz: (d,) and dtheta: (6,) gradient of the loss, zero for a variable without a
    gradient. at_points: (N, 3) gradient of the loss at the rendered points, from which dz and dtheta follow; None if no
    gradient reaches the points. render_ms, detector_ms (forward and backward), total_ms: times.
    """

    rendering: Rendering
    loss: float
    dz: Tensor
    dtheta: Tensor
    at_points: Tensor | None
    render_ms: float
    detector_ms: float
    total_ms: float


def attack_step(
    problem: AttackProblem,
    code: Tensor,
    theta: Tensor,
    radius_m: float | None,
    warm: WarmStart | None = None,
    of_code: bool = True,
    of_pose: bool = True,
    incremental: IncrementalInference | None = None,
    at_points: Tensor | None = None,
) -> AttackStep:
    """Compute and time one attack step, without the update of the variable.

    Args:
        problem: attack whose detector has the precision of the search.
        code, theta: (d,), (6,). radius_m: radius of the detector's window; None: the whole scene.
        of_code, of_pose: variables of the gradient; an attack on the shape needs of_code only.
        incremental: incremental inference that has processed the previous rendering, as in an attack.
        at_points: (N, 3) replaces the detector's gradient at the points; the backward pass is then the renderer's only.

    The backward pass stops at the points to time the detector's part. The gradient is the same as in one pass.
    """
    code = code.detach().clone().requires_grad_(of_code)
    theta = theta.detach().clone().requires_grad_(of_pose)
    start = time.perf_counter()
    measured = measure(problem, code, theta, warm, radius_m, incremental)
    forward = time.perf_counter()
    points, loss = measured.rendering.points, measured.adversarial
    gradients = {leaf: torch.zeros_like(leaf) for leaf in (code, theta)}
    half_way = forward
    if points.requires_grad and loss.requires_grad:
        if at_points is None:
            (at_points,) = torch.autograd.grad(loss, points, retain_graph=True)
        half_way = time.perf_counter()
        wanted = [leaf for leaf in (code, theta) if leaf.requires_grad]
        found = torch.autograd.grad(points, wanted, at_points, allow_unused=True)
        gradients |= {leaf: part for leaf, part in zip(wanted, found, strict=True) if part is not None}
    end = time.perf_counter()
    spent = measured.milliseconds
    return AttackStep(
        measured.rendering,
        float(loss.detach()),
        gradients[code].detach(),
        gradients[theta].detach(),
        at_points,
        spent["render"],
        spent["detector"] + 1e3 * (half_way - forward),
        1e3 * (end - start),
    )


def cosine(a: Tensor, b: Tensor) -> float:
    """Compute the cosine of the angle between two gradients; 1 if both are zero, 0 if one is zero or not finite."""
    a, b = a.double().flatten(), b.double().flatten()
    lengths = float(a.norm()) * float(b.norm())
    if lengths == 0:
        return 1.0 if float(a.norm()) == float(b.norm()) else 0.0
    if not math.isfinite(lengths):
        return 0.0
    return max(-1.0, min(1.0, float(a @ b) / lengths))


def norm_ratio(found: Tensor, true: Tensor) -> float:
    """Divide a gradient's length by the true gradient's; 1 if both are zero. At most 1e9, also over zero."""
    above, below = float(found.double().norm()), float(true.double().norm())
    if below == 0:
        return 1.0 if above == 0 else 1e9
    return min(above / below, 1e9) if math.isfinite(above) else 1e9
