"""The loss's gradient through renderer and detector, timed by stage, and how it compares with the reference's."""

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
    """One step of an attack: rendering, detector, constraints, and the way back.

    dz: (d,) and dtheta: (6,) gradient of the adversarial loss, zero where none was asked for. loss: its value.
    at_points: (N, 3) gradient at the rendered points, from which both follow; None where none reaches them.
    render_ms, detector_ms (forward and backward), total_ms: times.
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
    """What an attack does between two values of its variable, but for the subtraction.

    Args:
        problem: with the detector at the precision of the search.
        code, theta: (d,), (6,). radius_m: of the detector's window; None: the whole scene.
        of_code, of_pose: what the gradient is taken of; an attack on the shape takes the first alone.
        incremental: that has seen the rendering before this one, as in an attack.
        at_points: (N, 3), in place of the detector's gradient at the points: the way back is then the renderer's alone.

    The way back is walked in two parts, points first, so that the detector's can be timed; the gradient is the same.
    """
    code = code.detach().clone().requires_grad_(of_code)
    theta = theta.detach().clone().requires_grad_(of_pose)
    start = time.perf_counter()
    measured = measure(problem, code, theta, warm, radius_m, incremental)
    forward = time.perf_counter()
    points, loss = measured.rendering.points, measured.adversarial
    dz, dtheta = torch.zeros_like(code), torch.zeros_like(theta)
    half_way = forward
    if points.requires_grad and loss.requires_grad:
        if at_points is None:
            (at_points,) = torch.autograd.grad(loss, points, retain_graph=True)
        half_way = time.perf_counter()
        wanted = [leaf for leaf in (code, theta) if leaf.requires_grad]
        found = iter(torch.autograd.grad(points, wanted, at_points, allow_unused=True))
        parts = [next(found) if leaf.requires_grad else None for leaf in (code, theta)]
        dz, dtheta = (torch.zeros_like(leaf) if part is None else part for leaf, part in zip((code, theta), parts))
    end = time.perf_counter()
    spent = measured.milliseconds
    return AttackStep(
        measured.rendering,
        float(loss.detach()),
        dz.detach(),
        dtheta.detach(),
        at_points,
        spent["render"],
        spent["detector"] + 1e3 * (half_way - forward),
        1e3 * (end - start),
    )


def cosine(a: Tensor, b: Tensor) -> float:
    """Cosine of the angle between two gradients; 1 where both are zero, 0 where one is, or is not finite."""
    a, b = a.double().flatten(), b.double().flatten()
    lengths = float(a.norm()) * float(b.norm())
    if lengths == 0:
        return 1.0 if float(a.norm()) == float(b.norm()) else 0.0
    if not math.isfinite(lengths):
        return 0.0
    return max(-1.0, min(1.0, float(a @ b) / lengths))


def norm_ratio(found: Tensor, true: Tensor) -> float:
    """Length of a gradient over that of the true one; 1 where both are zero. A finite stand-in, 1e9, over zero."""
    above, below = float(found.double().norm()), float(true.double().norm())
    if below == 0:
        return 1.0 if above == 0 else 1e9
    return min(above / below, 1e9) if math.isfinite(above) else 1e9
