"""Random changes of the same size as an attack's, for comparison."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.pose import PAPER_LIMITS, PoseLimits, draw_pose, snap_pose
from shift3d.attack.problem import AttackProblem
from shift3d.placement.constraints import check

_ATTEMPTS = 60


def random_code(baseline_code: Tensor, radius: float, rng: np.random.Generator) -> Tensor:
    """Draw a code (d,) on the sphere around z0 with the adversarial code's latent distance, in the dtype of z0.

    Source: SHIFT3D, Adversarial Shape Generation Results (random shapes at the same latent distance).
    """
    normal = rng.standard_normal(len(baseline_code))
    direction = torch.from_numpy(normal / np.linalg.norm(normal))
    return (baseline_code.detach().double() + radius * direction).to(baseline_code.dtype)


def noise_codes(code: Tensor, sigma: float, count: int, rng: np.random.Generator) -> Tensor:
    """Draw (count, d) codes z + N(0, sigma^2 I), which test whether the adversarial shape is more than a single point.

    Source: SHIFT3D, Adversarial Shape Generation Results; 10 codes with sigma 0.01.
    """
    noise = torch.as_tensor(rng.standard_normal((count, len(code))) * sigma, dtype=torch.float64)
    return (code.detach().double() + noise).to(code.dtype)


def random_pose(problem: AttackProblem, rng: np.random.Generator, limits: PoseLimits = PAPER_LIMITS) -> Tensor | None:
    """Draw a `draw_pose` (6,) on the ground that keeps the realism constraints; None if no draw is valid."""
    metric = problem.metric(problem.code0.detach())
    for _ in range(_ATTEMPTS):
        theta = snap_pose(draw_pose(problem.theta0, rng, limits), problem, metric, limits)
        held = check(metric, problem.obstacles_at(theta), theta, problem.size_m, 0, problem.limits, problem.others)
        if not (held.overlap_ok and held.contact_ok and held.clear_ok):
            continue
        with torch.no_grad():
            rendering = problem.insert(problem.code0.detach(), theta).first_hits
        if rendering.object_points >= problem.limits.min_object_points:
            return theta
    return None
